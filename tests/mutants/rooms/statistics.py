"""Mistakes in intervals, comparisons, ranks and worst cases."""

from __future__ import annotations

from tests.mutants.mutant import Mutant

INTERVALS = "cp_env/metrics/intervals.py"
SHARES = "cp_env/metrics/shares.py"
COMPARISONS = "cp_env/evaluation/analysis/comparisons.py"
RANKS = "cp_env/evaluation/analysis/ranks.py"
WORST_CASE = "cp_env/evaluation/analysis/worst_case.py"
SUMMARY = "cp_env/evaluation/analysis/summary.py"
STRATA = "cp_env/evaluation/analysis/strata.py"
INTERVAL_TESTS = ("tests/cp_env/metrics/test_intervals.py",)
SHARE_TESTS = ("tests/cp_env/metrics/test_shares.py",)
COMPARISON_TESTS = ("tests/cp_env/evaluation/analysis/test_comparisons.py",)
RANK_TESTS = ("tests/cp_env/evaluation/analysis/test_ranks.py",)
WORST_CASE_TESTS = ("tests/cp_env/evaluation/analysis/test_worst_case.py",)
SUMMARY_TESTS = ("tests/cp_env/evaluation/analysis/test_summary.py",)
STRATA_TESTS = ("tests/cp_env/evaluation/analysis/test_strata.py",)

MUTANTS = (
    Mutant("the-spread-of-a-population", INTERVALS, "array.std(ddof=1)", "array.std()", INTERVAL_TESTS),
    Mutant(
        "a-one-sided-interval",
        INTERVALS,
        "0.5 + checked_confidence(confidence) / 2",
        "checked_confidence(confidence)",
        INTERVAL_TESTS,
    ),
    Mutant("one-degree-of-freedom-too-many", INTERVALS, "stdtrit(n - 1,", "stdtrit(n,", INTERVAL_TESTS),
    Mutant("a-jackknife-that-leaves-none-out", INTERVALS, "np.delete(rows, row)", "rows", INTERVAL_TESTS),
    Mutant("the-spread-of-left-out-figures", INTERVALS, "(n - 1) * float(left_out", "float(left_out", INTERVAL_TESTS),
    Mutant("the-plain-percentile", INTERVALS, 'method="BCa"', 'method="percentile"', INTERVAL_TESTS),
    Mutant("a-rate-by-wilson", INTERVALS, 'method="exact"', 'method="wilson"', INTERVAL_TESTS),
    Mutant("no-further-value-above", SHARES, "inside + weights[:, n]", "inside", SHARE_TESTS),
    Mutant(
        "both-tails-above",
        SHARES,
        "1 - tail)), mean)\n    return Interval(mean * whole",
        "1 - 2 * tail)), mean)\n    return Interval(mean * whole",
        SHARE_TESTS,
    ),
    Mutant(
        "values-in-the-order-they-came",
        SHARES,
        "np.sort(checked_values(values))",
        "checked_values(values)",
        SHARE_TESTS,
    ),
    Mutant("the-worst-scene-for-the-best", SHARES, "[best(chosen)", "[worst(chosen)", SHARE_TESTS),
    Mutant("bonferroni", COMPARISONS, "np.arange(len(p), 0, -1)", "len(p)", COMPARISON_TESTS),
    Mutant("adjusted-out-of-order", COMPARISONS, "np.maximum.accumulate(p[order]", "(p[order]", COMPARISON_TESTS),
    Mutant("told-apart-by-two-scenes", COMPARISONS, "FEWEST = 6", "FEWEST = 2", COMPARISON_TESTS),
    Mutant("told-apart-without-correction", COMPARISONS, "self.adjusted < LEVEL", "self.p < LEVEL", COMPARISON_TESTS),
    Mutant("unpaired", COMPARISONS, "differences = a - b", "differences = a - b.mean()", COMPARISON_TESTS),
    Mutant("first-of-equals-takes-all", RANKS, "wins / wins.sum(axis=1, keepdims=True)", "wins * 1.0", RANK_TESTS),
    Mutant(
        "scenes-in-equal-numbers",
        RANKS,
        ".multinomial(len(scenes), np.full(len(scenes), 1 / len(scenes)), resamples)",
        ".multinomial(1, np.full(len(scenes), 1 / len(scenes)), resamples)",
        RANK_TESTS,
    ),
    Mutant(
        "better-is-worse", RANKS, "if sign * pair.interval.mean < 0", "if sign * pair.interval.mean > 0", RANK_TESTS
    ),
    Mutant("seeds-that-some-have-not-played", WORST_CASE, "set.intersection(", "set.union(", WORST_CASE_TESTS),
    Mutant("screened-by-the-mildest", WORST_CASE, "measure.worst(list(", "measure.best(list(", WORST_CASE_TESTS),
    Mutant("the-bound-takes-a-rank", WORST_CASE, "if n not in informed", "if n", WORST_CASE_TESTS),
    Mutant(
        "seeds-are-units",
        SUMMARY,
        "return [float(np.mean(scene)) for scene in values if scene]",
        "return [float(value) for scene in values for value in scene]",
        SUMMARY_TESTS,
    ),
    Mutant(
        "the-other-stratum",
        STRATA,
        "(EGO in r.attackers) is attacks",
        "(EGO in r.attackers) is not attacks",
        STRATA_TESTS,
    ),
)
