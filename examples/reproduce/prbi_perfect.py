"""PRBI under a perfect verifier, compared with the paper's Tables 2 and 4 (n = 5).

    python examples/reproduce/prbi_perfect.py                 # ours and the paper's, with 95 % intervals
    python examples/reproduce/prbi_perfect.py --readings      # each reading of Algorithm 1

A view is abnormal if and only if its group contains an attacker. So this is the algorithm alone, without a detector.
With one attacker the verdict of one group says that of the other: a frame gives one bit. So a rule that misclassifies
nobody takes 12/5 = 2.40 frames or more on average if the attacker is drawn evenly, and 13/5 = 2.60 after a first split
of 4 and 1; the eight rows of the paper average 2.32. The benign vehicles misclassified at k = 2 and 3 are due to the
second condition: while random groups keep mixing attackers with a last benign vehicle of probability zero, m rises past
the number of zeros.

Columns. first: verifications in the first abnormal frame. pooled: verifications of all frames of all runs; our minimum
is 0 where ⌊m⌋ = 0, as one group is empty, and the other is the full view, which is free. "run means" is in the paper's
unit: the mean over runs of each run's mean, where such a frame counts 2. FPR: share of the benign vehicles that are
flagged, and share of the runs in which one is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import tyro
from rich.console import Console
from rich.progress import track
from rich.table import Table

from cp_env.metrics.intervals import Interval, bootstrap_interval, rate_interval, t_interval
from cp_env.metrics.shares import share_interval
from defenders import Prbi, Reading
from defenders.prbi.interpretation import SPLITS
from defenders.simulation.statistics import EpisodeStats, play_many
from defenders.simulation.world import Scenario

PAPER = {  # k: verifications min, max, first frame, mean; frames to convergence; ID %, MC %
    1: (2, 2, 2.00, 2.00, 2.25, 100, 0),
    2: (2, 4, 2.88, 2.35, 2.77, 100, 6),
    3: (2, 6, 4.06, 2.61, 3.36, 100, 0),
    4: (2, 8, 5.70, 2.86, 4.27, 100, 0),
}
EVEN = Reading(first="even", second="nearest", ties="index", flagged="zeros")
INDEPENDENT = Reading(split="replace", first="independent", second="nearest", ties="index")
T = TypeVar("T")
MAX_FRAMES = 99  # a scene of 100, of which the first is benign


@dataclass
class Args:
    episodes: int = 4000
    """episodes for each number of attackers"""
    seed: int = 0
    """seed of the episodes"""
    n: int = 5
    """vehicles"""
    readings: bool = False
    """compare the readings of Algorithm 1 instead"""
    stopping: str = "paper"
    """when PRBI stops: see `defenders.Prbi`"""


@dataclass(frozen=True)
class Variant:
    """A reading, how m is rounded when vehicles are grouped, and where the attackers stand."""

    label: str
    reading: Reading
    rounding: str = "floor"
    in_front: bool = False
    """whether the attackers are the vehicles 0 … k - 1, the ego first, or drawn"""


@dataclass(frozen=True)
class Figures:
    """The figures of one number of attackers; those of flagged vehicles, and the frames, are of runs that converged."""

    least: int
    most: int
    first: Interval  # verifications in the first abnormal frame
    pooled: Interval  # verifications a frame, over all frames
    run_means: Interval  # mean over runs of a run's mean; a frame that costs nothing counts 2
    frames: Interval  # to convergence
    identified: Interval  # share of the attackers that are flagged
    false_accusation_rate: Interval  # share of the benign vehicles that are flagged
    misclassified_runs: Interval  # share of the runs in which a benign vehicle is flagged
    unsettled: Interval  # share of the runs that never converged


def variants() -> list[Variant]:
    """Readings of the lines one by one, those in which m is rounded, and the two that come nearest to the paper."""
    plain = [(split, refresh) for split in SPLITS for refresh in (False, True)]
    return [
        *(
            Variant(f"split: {split}{', refresh' if refresh else ''}", Reading(split, refresh))
            for split, refresh in plain
        ),
        Variant("ties by index", Reading(ties="index")),
        Variant("second condition: nearest", Reading(second="nearest")),
        Variant("second condition: ceiling", Reading(second="ceiling")),
        Variant("second condition: nearest, zeros flagged", Reading(second="nearest", flagged="zeros")),
        Variant("even, attackers in front", EVEN, in_front=True),
        Variant("even, attackers drawn", EVEN),
        Variant("independent, nearest everywhere, attackers in front", INDEPENDENT, "nearest", in_front=True),
        Variant("independent, nearest everywhere, attackers drawn", INDEPENDENT, "nearest"),
    ]


def measure(args: Args, k: int, variant: Variant) -> Figures:
    defender = Prbi(reading=variant.reading, rounding=variant.rounding, stopping=args.stopping)
    benign = range(k, args.n) if variant.in_front else ()
    scenario = Scenario(n_vehicles=args.n, n_attackers=k, benign=benign, max_frames=MAX_FRAMES)
    stats = play_many(defender, scenario, episodes=args.episodes, seed=args.seed)
    done = np.flatnonzero(stats.converged)
    if not len(done):
        raise SystemExit(f"no episode converged with n = {args.n}, k = {k}")
    totals, misclassified = np.maximum(stats.verifications, 0).sum(1)[done], stats.false_accusation_rate[done]
    frames = stats.frames[done]
    return Figures(
        least=int(stats.all_verifications.min()),
        most=int(stats.all_verifications.max()),
        first=t_interval(stats.first),
        pooled=bootstrap_interval(lambda i: float(totals[i].sum() / frames[i].sum()), len(done), seed=args.seed),
        run_means=t_interval(run_means(stats)[done]),
        frames=t_interval(frames),
        identified=share_interval(100 * stats.identified[done], whole=100),
        false_accusation_rate=share_interval(100 * misclassified, whole=100),
        misclassified_runs=rate_interval(int((misclassified > 0).sum()), len(done)),
        unsettled=rate_interval(args.episodes - len(done), args.episodes),
    )


def run_means(stats: EpisodeStats) -> np.ndarray:
    """Each run's mean verifications, [episodes]; a frame in which one group was empty counts 2, as in the paper."""
    played = stats.verifications >= 0
    means: np.ndarray = np.where(played, np.maximum(stats.verifications, 2), 0).sum(1) / played.sum(1)
    return means


def paper_table(args: Args) -> Table:
    title = f"PRBI, perfect verifier, n = {args.n}, {args.episodes} episodes a row, 95 % intervals"
    heads = (
        "k",
        "",
        "min",
        "max",
        "first",
        "pooled",
        "run means",
        "frames",
        "TPR %",
        "FPR %",
        "FPR, runs %",
        "not conv.",
    )
    table = Table(*heads, title=title)
    for k in progress(range(1, args.n)):
        ours = measure(args, k, Variant("ours", Reading()))
        counts = [short(x, 2) for x in (ours.first, ours.pooled, ours.run_means, ours.frames)]
        rates = [short(ours.identified), short(ours.false_accusation_rate), percent(ours.misclassified_runs)]
        table.add_row(str(k), "ours", str(ours.least), str(ours.most), *counts, *rates, percent(ours.unsettled))
        if args.n == 5:
            least, most, first, mean, frames, tpr, fpr = PAPER[k]
            cells = [str(least), str(most), f"{first:.2f}", "", f"{mean:.2f}", f"{frames:.2f}", str(tpr), str(fpr)]
            table.add_row("", "paper", *cells, end_section=True)
    return table


def progress(items: Sequence[T]) -> Iterable[T]:
    return track(items, "playing", transient=True, console=Console(stderr=True))


def short(interval: Interval, digits: int = 0) -> str:
    return f"{interval.mean:.{digits}f} ± {(interval.high - interval.low) / 2:.{digits}f}"


def percent(rate: Interval) -> str:
    """A rate with its exact bounds, in per cent."""
    return f"{100 * rate.mean:.0f} [{100 * rate.low:.1f}, {100 * rate.high:.1f}]"


COLUMNS: dict[str, tuple[Callable[[Figures], float], int, int | None]] = {
    "frames": (lambda c: c.frames.mean, 2, 4),
    "run means": (lambda c: c.run_means.mean, 2, 3),
    "first": (lambda c: c.first.mean, 2, 2),
    "FPR %": (lambda c: c.false_accusation_rate.mean, 0, 6),
    "FPR, runs %": (lambda c: 100 * c.misclassified_runs.mean, 0, None),
    "TPR %": (lambda c: c.identified.mean, 0, 5),
}
"""A column of the readings: its value, digits, and where it stands in `PAPER`."""


def all_readings(args: Args) -> Iterator[str]:
    """A Markdown table: a row for each reading, and in each cell the figures at k = 1, 2, ..."""
    ks = range(1, args.n)
    yield f"{args.episodes} episodes a cell; in every cell k = {', '.join(map(str, ks))}\n"
    yield "| reading | " + " | ".join(COLUMNS) + " |\n|---|" + "---|" * len(COLUMNS)
    for variant in progress(variants()):
        cells = [measure(args, k, variant) for k in ks]
        row = [" ".join(f"{value(c):.{digits}f}" for c in cells) for value, digits, _ in COLUMNS.values()]
        yield f"| {variant.label} | " + " | ".join(row) + " |"
    if args.n == 5:
        row = [
            "" if place is None else " ".join(f"{PAPER[k][place]:.{digits}f}" for k in PAPER)
            for _, digits, place in COLUMNS.values()
        ]
        yield "| the paper | " + " | ".join(row) + " |"


def main(args: Args) -> None:
    if args.readings:
        for line in all_readings(args):
            print(line, flush=True)
    else:
        Console(width=160).print(paper_table(args))


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
