"""Mistakes in average precision, identification and ground truth."""

from __future__ import annotations

from tests.mutants.mutant import Mutant

AP = "cp_env/metrics/average_precision.py"
IDENTIFICATION = "cp_env/metrics/identification.py"
TRUTH = "cp_env/metrics/ground_truth.py"
FOLDER = "tests/cp_env/metrics/"
AP_TESTS = (
    f"{FOLDER}test_average_precision.py",
    f"{FOLDER}test_ap_protocols.py",
)
IDENTIFICATION_TESTS = (f"{FOLDER}test_identification.py",)
TRUTH_TESTS = (f"{FOLDER}test_ground_truth.py",)

MUTANTS = (
    Mutant(
        "precision-without-interpolation",
        AP,
        "np.maximum.accumulate(precision[::-1])[::-1]",
        "precision",
        AP_TESTS,
    ),
    Mutant(
        "recall-of-what-was-found",
        AP,
        "* ceiling).sum() / n_truth",
        "* ceiling).sum() / max(int(right[-1]), 1)",
        AP_TESTS,
    ),
    Mutant("a-hit-must-exceed-the-threshold", AP, "free[row, best] >= iou", "free[row, best] > iou", AP_TESTS),
    Mutant("a-truth-taken-by-many", AP, "free[:, best] = -1.0", "free[row, best] = -1.0", AP_TESTS),
    Mutant(
        "equal-scores-are-many-points",
        AP,
        "np.append(np.diff(scores) != 0, True)[: len(scores)]",
        "np.ones(len(scores), dtype=bool)",
        AP_TESTS,
    ),
    Mutant(
        "worst-detections-first",
        AP,
        'order = np.argsort(-scores, kind="stable")',
        'order = np.argsort(scores, kind="stable")',
        AP_TESTS,
    ),
    Mutant("merged-without-the-others-truth", AP, "self.n_truth + other.n_truth", "self.n_truth", AP_TESTS),
    Mutant(
        "frames-without-truth-are-kept",
        AP,
        "not (len(order) and overlap.shape[1])",
        "not len(order)",
        AP_TESTS,
    ),
    Mutant("a-score-at-the-limit-counts", AP, "scores > self.rules.above", "scores >= self.rules.above", AP_TESTS),
    Mutant(
        "ghosts-in-an-empty-street-are-perfect",
        AP,
        "0.0 if times @ n_found else of_nothing",
        "of_nothing",
        AP_TESTS,
    ),
    Mutant("all-detections-are-right", AP, "(mine, mine & hits)", "(mine, mine)", AP_TESTS),
    Mutant(
        "the-last-true-positive-is-left-out",
        AP,
        'ends, side="right")',
        'ends, side="left")',
        AP_TESTS,
    ),
    Mutant("always-a-second-choice", AP, "(free if second_choice else overlap)", "free", AP_TESTS),
    Mutant(
        "the-share-of-the-flagged",
        IDENTIFICATION,
        "/ len(set(attackers)) if attackers",
        "/ max(len(set(suspects)), 1) if attackers",
        IDENTIFICATION_TESTS,
    ),
    Mutant("benign-among-all", IDENTIFICATION, "/ len(benign) if benign", "/ n if benign", IDENTIFICATION_TESTS),
    Mutant(
        "recovery-of-the-clean-value",
        IDENTIFICATION,
        "(ap - attacked) / loss",
        "(ap - attacked) / clean",
        IDENTIFICATION_TESTS,
    ),
    Mutant(
        "nothing-lost-is-everything-restored",
        IDENTIFICATION,
        "return 1.0 if ap >= clean else 0.0",
        "return 1.0",
        IDENTIFICATION_TESTS,
    ),
    Mutant("the-ego-is-its-own-truth", TRUTH, "    inside[ego] = False\n", "", TRUTH_TESTS),
    Mutant("length-and-width-exchanged", TRUTH, "scene.size[rows, :2]", "scene.size[rows, 1::-1]", TRUTH_TESTS),
    Mutant(
        "truth-round-the-ego-itself",
        TRUTH,
        "pose[:, :2] - grid_origin(pose[ego, :2])",
        "pose[:, :2] - pose[ego, :2]",
        TRUTH_TESTS,
    ),
)
