"""How often an interval that says 95 % holds the true value, on samples like ours: the tables of docs/evaluation.md.

    python benchmarks/intervals.py                   # some minutes
    python benchmarks/intervals.py --samples 10000   # to half a percent

Tables in Markdown. Means over n scenes, of shares and of counts. Average precision that is pooled over n scenes.
Means over scenes of two episodes each, when episodes or scenes are taken for the unit. False verdicts of paired
comparisons of eight entries that are in truth alike.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import tyro
from jaxtyping import Float
from scipy import stats

from cp_env.evaluation.analysis.comparisons import holm
from cp_env.evaluation.analysis.summary import all_found, nothing_found
from cp_env.metrics.average_precision import resampled_ap
from cp_env.metrics.intervals import Interval, bootstrap_interval, jackknife_interval, t_interval
from cp_env.metrics.shares import pooled_share_interval, share_interval
from tests.helpers.skewed_samples import COUNTS, FOUND, SHARES, Family, scene


@dataclass(frozen=True)
class Args:
    """How many samples."""

    samples: int = 2000  # of each kind and size, of means
    pooled: int = 300  # of pooled average precision, which is slower
    resamples: int = 300  # of the bootstrap there
    sizes: tuple[int, ...] = (3, 6, 9, 21)
    seed: int = 0


Limits = tuple[Float[np.ndarray, " R"], Float[np.ndarray, " R"]]


def student(samples: Float[np.ndarray, "R n"]) -> Limits:
    return _limits([t_interval(row) for row in samples])


def gaffke(samples: Float[np.ndarray, "R n"]) -> Limits:
    return _limits([share_interval(row) for row in samples])


def bca(samples: Float[np.ndarray, "R n"]) -> Limits:
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        found = stats.bootstrap((samples,), np.mean, axis=-1, n_resamples=999, batch=20, random_state=1)
    mean = samples.mean(axis=-1)
    low, high = (np.where(np.isnan(end), mean, end) for end in found.confidence_interval)
    return low, high


def _limits(intervals: Sequence[Interval]) -> Limits:
    return np.array([i.low for i in intervals]), np.array([i.high for i in intervals])


def said(limits: Limits, truth: float) -> str:
    """Share that holds the truth, and the mean width."""
    low, high = limits
    return f"{np.mean((low <= truth + 1e-9) & (truth - 1e-9 <= high)):.2f} ({np.mean(high - low):.2f})"


def rows_of_means(
    families: dict[str, Family], methods: Sequence[Callable[..., Limits]], args: Args
) -> Iterator[list[str]]:
    for name, family in families.items():
        cells = []
        for n in args.sizes:
            samples = family.draw(np.random.default_rng([args.seed, n]), (args.samples, n))
            cells += [said(method(samples), family.mean) for method in methods]
        yield [name, *cells]


def rows_of_ap(args: Args) -> Iterator[list[str]]:
    for kind in FOUND:
        rng = np.random.default_rng(args.seed)
        everyone = [scene(rng, kind) for _ in range(20_000)]
        truth, cells = resampled_ap(everyone, 0.5)(np.arange(len(everyone))), []
        for n in args.sizes:
            found: list[list[Interval]] = [[], [], []]
            for number in range(args.pooled):
                pool = [everyone[i] for i in rng.integers(len(everyone), size=n)]
                ap, worst, best = (
                    resampled_ap([*pool, *more], 0.5) for more in ([], [nothing_found(pool)], [all_found(pool)])
                )
                found[0].append(jackknife_interval(ap, n))
                found[1].append(bootstrap_interval(ap, n, seed=number, resamples=args.resamples))
                found[2].append(pooled_share_interval(ap, worst, best, n, seed=number, resamples=args.resamples))
            cells += [said(_limits(of), truth) for of in found]
        yield [kind, *cells]


def rows_of_units(args: Args) -> Iterator[list[str]]:
    """Two episodes a scene; some of the spread is the scene's."""
    for shared in (0.0, 0.25, 0.5, 0.75):
        cells = []
        for n in args.sizes:
            rng = np.random.default_rng([args.seed, n])
            scenes, own = rng.normal(size=(args.samples, n, 1)), rng.normal(size=(args.samples, n, 2))
            values = np.sqrt(shared) * scenes + np.sqrt(1 - shared) * own
            cells += [said(student(values.reshape(len(values), -1)), 0.0), said(student(values.mean(axis=-1)), 0.0)]
        yield [f"{shared:g}", *cells]


def rows_of_comparisons(args: Args) -> Iterator[list[str]]:
    """Eight entries that are alike: how often a table of all 28 pairs holds even one verdict."""
    first, second = np.array(list(combinations(range(8), 2))).T
    for name, family in SHARES.items():
        cells = []
        for n in args.sizes:
            values = family.draw(np.random.default_rng([args.seed, n]), (args.samples, n, 8))
            with np.errstate(all="ignore"), warnings.catch_warnings():
                warnings.simplefilter("ignore")
                tested = stats.ttest_1samp(values[..., first] - values[..., second], 0.0, axis=1)
            p = np.where(np.isnan(tested.pvalue), 1.0, tested.pvalue)
            wrong = [[float(holm(row).min()) < 0.05, float(row.min()) < 0.05] for row in p]
            cells += [f"{rate:.3f}" for rate in np.mean(wrong, axis=0)]
        yield [name, *cells]


def show(title: str, what: str, names: Sequence[str], rows: Iterator[list[str]], args: Args) -> None:
    heads = [what, *(f"n = {n}, {name}" for n in args.sizes for name in names)]
    print(f"\n{title}\n\n| {' | '.join(heads)} |\n|---|{'--:|' * (len(heads) - 1)}", flush=True)
    for row in rows:
        print(f"| {' | '.join(row)} |", flush=True)


def main(args: Args) -> None:
    width = "share of intervals that hold the mean (mean width)"
    three = ("t", "BCa", "Gaffke")
    show(f"Shares: {width}", "values", three, rows_of_means(SHARES, (student, bca, gaffke), args), args)
    show(f"Counts: {width}", "values", three[:2], rows_of_means(COUNTS, (student, bca), args), args)
    pooled = "share of intervals that hold the AP of 20,000 scenes (mean width)"
    show(f"Pooled AP: {pooled}", "scenes", ("jackknife t", "BCa", "Gaffke"), rows_of_ap(args), args)
    units = "Two episodes of each of n scenes, Student's t: the unit is the episode, or the scene"
    what = "share of the variance that is the scene's"
    show(f"{units}; {width}", what, ("episode", "scene"), rows_of_units(args), args)
    wrong = "Eight entries that are alike: share of tables of 28 pairs with a false verdict"
    show(wrong, "values", ("Holm", "uncorrected"), rows_of_comparisons(args), args)


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
