"""Mistakes in the similarity of two views, PRBI Eq. (5), and in the agreement of score maps."""

from __future__ import annotations

from tests.mutants.mutant import Mutant

FILE = "cp_env/metrics/similarity.py"
TESTS = ("tests/cp_env/metrics/test_similarity.py",)

MUTANTS = (
    Mutant(
        "matched-boxes-counted-twice-in-the-union",
        FILE,
        "dtype=np.intp) - pairs",
        "dtype=np.intp)",
        TESTS,
    ),
    Mutant("two-empty-views-differ", FILE, "np.maximum(union, 1), 1.0)", "np.maximum(union, 1), 0.0)", TESTS),
    Mutant(
        "motion-with-the-wrong-sign",
        FILE,
        "np.asarray(a.origin, dtype=np.float64) - b.origin",
        "np.asarray(b.origin, dtype=np.float64) - a.origin",
        TESTS,
    ),
    Mutant("boxes-moved-in-place", FILE, "boxes_a.astype(np.float64)", "np.asarray(boxes_a, np.float64)", TESTS),
    Mutant("common-ground-on-the-wrong-side", FILE, "boxes_b[:, :2] - motion", "boxes_b[:, :2] + motion", TESTS),
    Mutant("newer-boxes-out-of-range-count", FILE, "boxes_b[inside_b]", "boxes_b", TESTS),
    Mutant("apart-on-both-axes-only", FILE, "2 * extent).any())", "2 * extent).all())", TESTS),
    Mutant("apart-at-half-the-distance", FILE, ">= 2 * extent)", ">= extent)", TESTS),
    Mutant("agreement-weighs-classes-once", FILE, "total[present] ** 2", "total[present]", TESTS),
    Mutant("agreement-with-axes-exchanged", FILE, "right, up = np.rint(cells)", "up, right = np.rint(cells)", TESTS),
    Mutant(
        "overlap-before-number-of-pairs",
        FILE,
        "min(pair.shape) + 1 + value",
        "value",
        TESTS,
    ),
    Mutant("one-box-matched-twice", FILE, "keep = alone_i & (", "keep = alone_i | (", TESTS),
)
