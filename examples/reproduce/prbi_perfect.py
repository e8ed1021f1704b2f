"""PRBI under a perfect verifier, compared with the paper's Tables 2 and 4 (n = 5).

    python examples/reproduce/prbi_perfect.py                 # ours and the paper's, with 95 % intervals
    python examples/reproduce/prbi_perfect.py --readings      # each reading of Algorithm 1

A view is abnormal if and only if its group contains an attacker. So this is the algorithm alone, without a detector.
The counts of the first abnormal frame agree with the paper's. Its frames to convergence are out of reach of the
algorithm as printed. With one attacker, the first frame's groups of 4 and 1 identify it in 1 of 5 runs. The second
frame's groups of 2 and 3 leave two candidates in all others. So a defender that misclassifies no vehicle needs at least
0.2 · 1 + 0.8 · 3 = 2.6 frames; the paper has 2.25 at an MC rate of 0. The benign vehicles misclassified at k = 2 and 3
are due to the second condition: while random groups keep mixing attackers with a last benign vehicle of probability
zero, m rises past the number of zeros. min, max and mean are verifications over all frames, and first those in the
first abnormal frame. Our minimum is 0 where ⌊m⌋ = 0: one group is empty, and the other is the full view, which is free.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import tyro
from rich.console import Console
from rich.progress import track
from rich.table import Table

from cp_env.metrics.intervals import Interval, bootstrap_interval, t_interval
from cp_env.metrics.shares import share_interval
from defenders import Prbi, Reading
from defenders.prbi.interpretation import SPLITS
from defenders.simulation.world import Episode, play

PAPER = {  # k: verifications min, max, first frame, mean; frames to convergence; ID %, MC %
    1: (2, 2, 2.00, 2.00, 2.25, 100, 0),
    2: (2, 4, 2.88, 2.35, 2.77, 100, 6),
    3: (2, 6, 4.06, 2.61, 3.36, 100, 0),
    4: (2, 8, 5.70, 2.86, 4.27, 100, 0),
}


@dataclass
class Args:
    episodes: int = 4000
    """episodes for each number of attackers"""
    seed: int = 0
    """seed of the first episode; the others count on from it"""
    n: int = 5
    """vehicles"""
    readings: bool = False
    """compare the readings of Algorithm 1 instead"""
    stopping: str = "paper"
    """when PRBI stops: see `defenders.Prbi`"""


@dataclass(frozen=True)
class Figures:
    """The figures of one number of attackers."""

    least: int
    most: int
    first: Interval  # verifications in the first abnormal frame
    mean: Interval  # verifications a frame, over all frames
    frames: Interval  # to convergence
    identified: Interval  # share of the attackers that are flagged
    false_accusation_rate: Interval  # share of the benign vehicles that are flagged
    unsettled: float  # share of episodes that never converged


def measure(args: Args, k: int, reading: Reading) -> Figures:
    seeds = track(range(args.seed, args.seed + args.episodes), f"k = {k}", transient=True)
    played = [play(Prbi(reading=reading, stopping=args.stopping), args.n, k, seed) for seed in seeds]
    done = [episode for episode in played if episode.converged]
    if not done:
        raise SystemExit(f"no episode converged with n = {args.n}, k = {k}")
    counts = np.array([sum(episode.verifications) for episode in done])
    frames = np.array([len(episode.results) for episode in done])
    return Figures(
        least=min(min(episode.verifications) for episode in played),
        most=max(max(episode.verifications) for episode in played),
        first=t_interval([episode.verifications[0] for episode in played]),
        mean=bootstrap_interval(lambda i: float(counts[i].sum() / frames[i].sum()), len(done), seed=args.seed),
        frames=t_interval(frames),
        identified=share_interval([100 * share(episode, attackers=True) for episode in done], whole=100),
        false_accusation_rate=share_interval([100 * share(episode, attackers=False) for episode in done], whole=100),
        unsettled=1 - len(done) / len(played),
    )


def share(episode: Episode, *, attackers: bool) -> float:
    """Share of the attackers, or of the benign vehicles, that are flagged."""
    n = len(episode.suspects | episode.results[-1].verdict.collaborators)
    counted = episode.attackers if attackers else frozenset(range(n)) - episode.attackers
    return len(counted & episode.suspects) / len(counted)


def paper_table(args: Args) -> Table:
    title = f"PRBI, perfect verifier, n = {args.n}, {args.episodes} episodes a row, 95 % intervals"
    table = Table("k", "", "min", "max", "first", "mean", "frames", "TPR %", "FPR %", "not conv. %", title=title)
    for k in range(1, args.n):
        ours = measure(args, k, Reading())
        row = [short(x, 2) for x in (ours.first, ours.mean, ours.frames)] + [
            short(ours.identified),
            short(ours.false_accusation_rate),
        ]
        table.add_row(str(k), "ours", str(ours.least), str(ours.most), *row, f"{100 * ours.unsettled:.0f}")
        if args.n == 5:
            least, most, first, mean, frames, *rates = PAPER[k]
            figures = [f"{x:.2f}" for x in (first, mean, frames)]
            table.add_row("", "paper", str(least), str(most), *figures, *map(str, rates), "", end_section=True)
    return table


def short(interval: Interval, digits: int = 0) -> str:
    return f"{interval.mean:.{digits}f} ± {(interval.high - interval.low) / 2:.{digits}f}"


def all_readings(args: Args) -> Table:
    readings = [Reading(split, refresh) for split in SPLITS for refresh in (False, True)]
    readings += [Reading(second="nearest"), Reading(second="ceiling"), Reading(ties="index")]
    columns = ("split", "refresh", "second", "ties", *(f"k = {k}" for k in range(1, args.n)))
    table = Table(*columns, title=f"frames · TPR % · FPR %, {args.episodes} episodes a cell")
    for reading in readings:
        cells = [measure(args, k, reading) for k in range(1, args.n)]
        row = [f"{c.frames.mean:.2f} · {c.identified.mean:.0f} · {c.false_accusation_rate.mean:.0f}" for c in cells]
        table.add_row(reading.split, str(reading.refresh), reading.second, reading.ties, *row)
    if args.n == 5:
        table.add_row("paper", "", "", "", *(f"{PAPER[k][4]:.2f} · {PAPER[k][5]} · {PAPER[k][6]}" for k in PAPER))
    return table


def main(args: Args) -> None:
    Console(width=120).print(all_readings(args) if args.readings else paper_table(args))


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
