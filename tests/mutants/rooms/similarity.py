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
        "motion = older - newer",
        "motion = newer - older",
        TESTS,
    ),
    Mutant("boxes-moved-in-place", FILE, "after = before.copy()", "after = before", TESTS),
    Mutant("common-ground-on-the-wrong-side", FILE, "_inside(b, -motion,", "_inside(b, motion,", TESTS),
    Mutant("newer-boxes-out-of-range-count", FILE, "after[inside], before[inside]", "after[inside], before", TESTS),
    Mutant("apart-on-both-axes-only", FILE, "2 * extent).any(axis=1)", "2 * extent).all(axis=1)", TESTS),
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
