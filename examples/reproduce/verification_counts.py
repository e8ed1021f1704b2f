"""Verifications in a frame, Table 2 of the PRBI paper: ours, the exact expectation and the paper's values.

    python examples/reproduce/verification_counts.py                     # perfect verifier, 20,000 episodes a cell
    python examples/reproduce/verification_counts.py --detector          # the shipped detector under PGD, a few scenes

ROBOSAC (reading "until_success", k known) and PASAC trust the ego. As published, k of its n collaborators are
malicious, so there are n + 1 vehicles. PRBI trusts no vehicle: k of n vehicles are malicious, and the ego may be one of
them. Only frames with an attack count. ROBOSAC and PASAC begin anew in every frame, so each frame is an episode to
them. Of PRBI there are two rows: the first abnormal frame, and all frames to convergence. "exact" is computed, not
played. C(n, k) teams of n - k contain one clean team, so ROBOSAC's tries are geometric with that mean and have no
maximum. PASAC is averaged over all sets of attackers. The paper's maxima of ROBOSAC are those of some hundred frames.
"""

from __future__ import annotations

import itertools
import json
import math
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import tyro
from rich.console import Console
from rich.progress import track
from rich.table import Table

import defenders
from cp_env.metrics.intervals import Interval, bootstrap_interval, jackknife_interval
from cp_env.rendering import style
from cp_env.settings import Precision
from defenders.pasac import halves
from defenders.simulation.statistics import play_many
from defenders.simulation.world import Scenario

ROWS = ("ROBOSAC", "PASAC", "PRBI, first abnormal frame", "PRBI, all frames")
PAPER = {  # of n = 5, k = 1 … 4: least, most, mean
    "ROBOSAC": ((1, 19, 4.89), (1, 39, 10.36), (1, 46, 8.29), (1, 17, 4.73)),
    "PASAC": ((4, 6, 4.79), (4, 8, 6.60), (6, 8, 7.59), (8, 8, 8.00)),
    "PRBI, first abnormal frame": ((2, 2, 2.00), (2, 4, 2.88), (2, 6, 4.06), (2, 8, 5.70)),  # its Table 4
    "PRBI, all frames": ((2, 2, 2.00), (2, 4, 2.35), (2, 6, 2.61), (2, 8, 2.86)),
}
ROUND = 100  # frames with the same attackers, where every frame counts as an episode
MANY = 100  # episodes from which on the bootstrap covers: see `cp_env.metrics.intervals`
MOST_FRAMES = 200  # for PRBI to converge
COLOURS = dict(zip(ROWS, [style.DEFENDERS[name] for name in ("robosac", "pasac", "robust_prbi", "prbi")], strict=True))


@dataclass(frozen=True)
class Args:
    n: int = 5
    """vehicles that may be malicious: the collaborators of ROBOSAC and PASAC, all vehicles of PRBI"""
    episodes: int = 20_000
    """of ROBOSAC and PASAC for each k, with the perfect verifier"""
    prbi_episodes: int = 4000
    """of PRBI, which takes several frames to an episode"""
    rows: tuple[str, ...] = ROWS
    seed: int = 0
    detector: bool = False
    """count on the shipped detector under PGD instead"""
    scenes: str = "junction/test"
    """with the detector; ROBOSAC and PASAC need n + 1 connected vehicles, which most scenes of the town lack"""
    n_scenes: int = 3
    frames: int = 6
    """of every scene, with the detector"""
    precision: Precision = "float32"
    """of the detector's maps, fusion and decoder"""
    threads: int = 1
    out: Path = Path("out/verifications")


def make(row: str, k: int, args: Args) -> tuple[defenders.Defender, int, tuple[int, ...]]:
    """The defender of a row, its number of vehicles, and the trusted ones among them."""
    if row == "ROBOSAC":
        return defenders.make("robosac", reading="until_success", n_attackers=k), args.n + 1, (0,)
    if row == "PASAC":
        return defenders.make("pasac"), args.n + 1, (0,)
    return defenders.make("prbi"), args.n, ()


def count(row: str, k: int, args: Args) -> np.ndarray:
    """Verifications under a perfect verifier, [episodes, frames]; -1 behind the end of an episode."""
    defender, n_vehicles, benign = make(row, k, args)
    frames = {"PRBI, first abnormal frame": 1, "PRBI, all frames": MOST_FRAMES}.get(row, ROUND)
    scenario = Scenario(n_vehicles=n_vehicles, n_attackers=k, benign=benign, max_frames=frames)
    episodes = args.prbi_episodes if row.startswith("PRBI") else math.ceil(args.episodes / ROUND)
    return play_many(defender, scenario, episodes=episodes, seed=args.seed).verifications


def count_on_detector(row: str, k: int, args: Args) -> np.ndarray:
    """The same on the shipped detector: a scene is an episode, and PGD attacks k vehicles from the second frame on."""
    import torch

    import agents
    from cp_env.detector.registry import open_detector
    from cp_env.scenes import open_source
    from cp_env.world.scene_cache import SceneBank
    from cp_env.world.world import World

    torch.set_num_threads(args.threads)
    bank = SceneBank(open_source(args.scenes), open_detector(precision=args.precision))
    counts = np.full((args.n_scenes, args.frames - 1), -1)
    names = bank.source.names()
    for number, scene in enumerate(names[i * len(names) // args.n_scenes] for i in range(args.n_scenes)):
        rng = np.random.default_rng([args.seed, number, k])
        defender, n_vehicles, benign = make(row, k, args)
        attackers = tuple(sorted((len(benign) + rng.permutation(n_vehicles - len(benign))[:k]).tolist()))
        world = World(
            1, defender=defender, bank=bank, n_vehicles=n_vehicles, attackers=attackers, max_frames=args.frames
        )
        world.reset([np.random.SeedSequence([args.seed, number, k])], options={"scene": scene})
        attack = agents.make("pgd")
        attack.reset(1, rng.spawn(1))
        for frame in range(args.frames):
            outcome = world.step(attack.act(world.situation()))
            if frame:
                counts[number, frame - 1] = outcome.verifications[0]
            if outcome.verdicts[0].converged or (frame == 1 and row == "PRBI, first abnormal frame"):
                break
    return counts


def pooled(counts: np.ndarray) -> np.ndarray:
    """One entry for each frame."""
    return counts[counts >= 0]


def mean(counts: np.ndarray, seed: int) -> Interval:
    """Mean over all frames; the interval is over episodes, because the frames of one are similar."""
    played = counts >= 0
    totals, frames = np.where(played, counts, 0).sum(axis=1), played.sum(axis=1)

    def of(rows: np.ndarray) -> float:
        return float(totals[rows].sum() / frames[rows].sum())

    if len(counts) >= MANY:
        return bootstrap_interval(of, len(counts), seed=seed)
    found = jackknife_interval(of, len(counts))
    return replace(found, low=max(found.low, 0.0))


def exact(row: str, n: int, k: int) -> float | None:
    """The expectation under a perfect verifier, where it can be worked out."""
    if row == "ROBOSAC":
        return float(math.comb(n, k))
    if row == "PASAC":
        return float(
            np.mean(
                [
                    pasac_verifications(list(range(n)), set(attackers))
                    for attackers in itertools.combinations(range(n), k)
                ]
            )
        )
    return None


def pasac_verifications(members: list[int], attackers: set[int]) -> int:
    """Halves that PASAC verifies below a part that failed."""
    if len(members) < 2:
        return 0
    return sum(
        1 + (pasac_verifications(half, attackers) if attackers.intersection(half) else 0) for half in halves(members)
    )


def main(args: Args) -> None:
    measure, verifier = (count_on_detector, "shipped detector, PGD") if args.detector else (count, "perfect verifier")
    counts: dict[tuple[str, int], np.ndarray] = {}
    for row, k in track(list(itertools.product(args.rows, range(1, args.n))), "counting", transient=True):
        counts[row, k] = measure(row, k, args)
    means = {key: mean(table, args.seed) for key, table in counts.items()}
    console = Console(width=120)
    console.print(paper_table(counts, means, args, f"{verifier}, n = {args.n}"))
    args.out.mkdir(parents=True, exist_ok=True)
    stem = args.out / ("detector" if args.detector else "perfect")
    rows = [
        {
            "defender": row,
            "k": k,
            **asdict(means[row, k]),
            "least": int(c.min()),
            "most": int(c.max()),
            "frames": c.size,
        }
        for (row, k), c in ((key, pooled(table)) for key, table in counts.items())
    ]
    stem.with_suffix(".json").write_text(json.dumps({"verifier": verifier, "rows": rows}, indent=1) + "\n")
    console.print("drawn:", str(draw(counts, means, args, stem.with_suffix(".png"), verifier)))


def paper_table(
    counts: dict[tuple[str, int], np.ndarray], means: dict[tuple[str, int], Interval], args: Args, title: str
) -> Table:
    table = Table("", "k", "mean [95 %]", "exact", "min", "max", "paper: mean", "min", "max", title=title)
    for row, k in counts:
        frames, worked = pooled(counts[row, k]), exact(row, args.n, k)
        least, most, average = PAPER[row][k - 1] if args.n == 5 else ("", "", math.nan)
        ours = f"{means[row, k]:.2f}", "" if worked is None else f"{worked:.2f}", frames.min(), frames.max()
        cells = map(str, (*ours, "" if math.isnan(average) else f"{average:.2f}", least, most))
        table.add_row(row if k == 1 else "", str(k), *cells, end_section=k == args.n - 1)
    return table


@style.plot_style()
def draw(
    counts: dict[tuple[str, int], np.ndarray],
    means: dict[tuple[str, int], Interval],
    args: Args,
    path: Path,
    verifier: str,
) -> Path:
    figure, (left, right) = plt.subplots(1, 2, figsize=(style.PAGE, 3.9), layout="constrained")
    attackers, middle = np.arange(1, args.n), args.n // 2
    mark: dict[str, Any] = {"ms": 7, "mew": 1.6}
    for shift, row in zip(np.linspace(-0.18, 0.18, len(args.rows)), args.rows, strict=True):
        ours = [means[row, k] for k in range(1, args.n)]
        reach = [[i.mean - i.low for i in ours], [i.high - i.mean for i in ours]]
        line: dict[str, Any] = {"color": COLOURS[row], "label": row}
        left.errorbar(attackers + shift, [i.mean for i in ours], reach, fmt="o-", ms=4, capsize=3, **line)
        if args.n == 5:
            left.plot(
                attackers + shift, [average for *_, average in PAPER[row]], "x", ms=7, mew=1.6, color=COLOURS[row]
            )
        values, first = np.unique(np.sort(pooled(counts[row, middle])), return_index=True)
        right.step(values, 1 - first / pooled(counts[row, middle]).size, where="pre", **line)
    if args.n == 5:
        left.plot([], [], "x", **mark, color=style.GREY, label="the paper's mean")
    left.set(xlabel="attackers k", ylabel="verifications/frame", xticks=attackers, ylim=(0, None))
    left.set_title("mean, 95 % intervals over episodes")
    right.set(xlabel="x, verifications in a frame", ylabel="share of frames with x or more", yscale="log")
    right.yaxis.set_major_formatter("{x:g}")
    right.set_title(f"k = {middle}")
    handles, labels = left.get_legend_handles_labels()
    own = [labels.index(row) for row in args.rows]
    order = [*own, *(number for number in range(len(labels)) if number not in own)]
    figure.legend([handles[i] for i in order], [labels[i] for i in order], loc="outside lower center", ncols=3)
    figure.suptitle(f"Verifications in a frame, n = {args.n}, {verifier}")
    style.save_plot(figure, path)
    plt.close(figure)
    return path


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
