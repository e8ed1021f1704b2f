"""Mistakes in PRBI, Algorithm 1 and Eqs. (6)-(14), and in its corrected stopping rule."""

from __future__ import annotations

from tests.mutants.mutant import Mutant

FOLDER = "defenders/prbi/"
TESTS = "tests/defenders/prbi/"
INFERENCE = (f"{TESTS}test_inference.py",)
VIEWS = (f"{TESTS}test_frame_views.py",)
DEFENDER = (f"{TESTS}test_defender.py",)
GROUPS = (f"{TESTS}test_group_testing.py",)
ROBUST = (f"{TESTS}test_robust.py",)
DEFENDER_EDGES = (f"{TESTS}test_defender_edges.py",)
INFERENCE_EDGES = (f"{TESTS}test_inference_edges.py",)
ROBUST_EDGES = (f"{TESTS}test_robust_edges.py",)

MUTANTS = (
    Mutant(
        "the-natural-logarithm",
        f"{FOLDER}inference.py",
        "math.log2(1 / eta)",
        "math.log(1 / eta)",
        INFERENCE,
    ),
    Mutant(
        "as-many-attackers-as-vehicles", f"{FOLDER}inference.py", "len(normal) - 1.0", "float(len(normal))", INFERENCE
    ),
    Mutant(
        "gamma-and-lambda-exchanged",
        f"{FOLDER}inference.py",
        "gamma * previous + lam * normal / seen",
        "lam * previous + gamma * normal / seen",
        INFERENCE,
    ),
    Mutant(
        "the-likelihood-among-all",
        f"{FOLDER}inference.py",
        "np.maximum(total.sum() - total, 1)",
        "np.maximum(total.sum(), 1)",
        INFERENCE,
    ),
    Mutant(
        "a-vehicles-own-abnormal-frames",
        f"{FOLDER}inference.py",
        "(abnormal.sum() - abnormal) / others",
        "abnormal / others",
        INFERENCE,
    ),
    Mutant(
        "without-the-evidence",
        f"{FOLDER}inference.py",
        "prior *= likelihood / attack",
        "prior *= likelihood",
        INFERENCE,
    ),
    Mutant(
        "a-deviation-of-a-population",
        f"{FOLDER}inference.py",
        "np.std(window, ddof=1)",
        "np.std(window)",
        INFERENCE_EDGES,
    ),
    Mutant(
        "a-quantile-of-one-side",
        f"{FOLDER}inference.py",
        "stdtrit(freedom, 1 - alpha / 2)",
        "stdtrit(freedom, 1 - alpha)",
        INFERENCE,
    ),
    Mutant("halves-to-even", f"{FOLDER}inference.py", "math.floor(m + 0.5)", "round(m)", INFERENCE),
    Mutant(
        "epsilon-must-be-exceeded",
        f"{FOLDER}frame_views.py",
        "self.similarity(group) >= self.epsilon(group)",
        "self.similarity(group) > self.epsilon(group)",
        VIEWS,
    ),
    Mutant(
        "a-seen-group-is-paid-again",
        f"{FOLDER}frame_views.py",
        "[group for group in groups if group not in self.views], True",
        "list(groups), True",
        VIEWS,
    ),
    Mutant(
        "the-output-is-a-verification",
        f"{FOLDER}frame_views.py",
        "if group not in self.views else [], False",
        "if group not in self.views else [], True",
        VIEWS,
    ),
    Mutant(
        "a-rejected-view-is-free",
        f"{FOLDER}frame_views.py",
        "yield Query([group])",
        "yield Query([group], False)",
        VIEWS,
    ),
    Mutant(
        "support-of-overlapping-groups",
        f"{FOLDER}frame_views.py",
        "if group.isdisjoint(other)",
        "if group != other",
        VIEWS,
    ),
    Mutant(
        "absent-vehicles-are-sampled",
        f"{FOLDER}defender.py",
        "order = [i for i in self.order.tolist() if i in self.present]",
        "order = self.order.tolist()",
        DEFENDER_EDGES,
    ),
    Mutant(
        "absent-vehicles-are-counted",
        f"{FOLDER}defender.py",
        "self.total[list(self.present)] += 1\n",
        "self.total += 1\n",
        DEFENDER_EDGES,
    ),
    Mutant("m-begins-at-n", f"{FOLDER}defender.py", "self.m = n - 1.0", "self.m = float(n)", DEFENDER),
    Mutant(
        "the-least-suspicious-first",
        f"{FOLDER}defender.py",
        "return ties[self.probability[ties].argsort",
        "return ties[(-self.probability[ties]).argsort",
        DEFENDER,
    ),
    Mutant(
        "the-second-condition-is-a-bound",
        f"{FOLDER}defender.py",
        "return zeros == round_attackers",
        "return zeros >= round_attackers",
        DEFENDER,
    ),
    Mutant(
        "the-least-similar-view", f"{FOLDER}defender.py", "return max(self._others", "return min(self._others", DEFENDER
    ),
    Mutant(
        "a-reference-that-is-never-renewed",
        f"{FOLDER}defender.py",
        "yield from frame_views.perceive(group)\n        self.reference = frame_views.views[group]\n",
        "yield from frame_views.perceive(group)\n",
        DEFENDER,
    ),
    Mutant("the-second-half-first", f"{FOLDER}defender.py", "stack += reversed(halves)", "stack += halves", DEFENDER),
    Mutant(
        "the-smaller-group-is-halved-first",
        f"{FOLDER}defender.py",
        "sorted(failed, key=len)",
        "sorted(failed, key=len, reverse=True)",
        DEFENDER_EDGES,
    ),
    Mutant("belief-in-benignity", f"{FOLDER}defender.py", "return 1 - np.clip(", "return np.clip(", DEFENDER),
    Mutant("nobody-is-fused", f"{FOLDER}defender.py", " or frozenset({0})", "", DEFENDER_EDGES),
    Mutant(
        "a-contradiction-that-is-not-seen",
        f"{FOLDER}group_testing.py",
        "group <= self.cleared",
        "group < self.cleared",
        GROUPS,
    ),
    Mutant(
        "convicted-alone-only",
        f"{FOLDER}group_testing.py",
        "(group - self.cleared for group in self.failed)",
        "(group for group in self.failed)",
        GROUPS,
    ),
    Mutant(
        "nothing-learned-is-news",
        f"{FOLDER}group_testing.py",
        "len(self.open) < before",
        "len(self.open) <= before",
        GROUPS,
    ),
    Mutant(
        "the-second-group-holds-nobody-open",
        f"{FOLDER}robust.py",
        "min(cut, len(unsure) - 1)",
        "min(cut, len(unsure))",
        ROBUST_EDGES,
    ),
    Mutant("a-wrong-reference-for-longer", f"{FOLDER}robust.py", "self.lost < 2", "self.lost < 3", ROBUST),
)
