"""How probable is a similarity, given who was fused and who of them lied? The densities that `bayes` ships with.

    python examples/calibrate_likelihood.py                                    # measure and print
    python examples/calibrate_likelihood.py --write defenders/likelihood.json  # and ship

On the calibration scenes the views of every group of five vehicles are compared, Eq. (5), with those of every group
the frame before, while nobody lies (then also with those of two and three frames before) and while PGD lies jointly in
k = 1 … 4 vehicles. Histograms are smoothed
by a Gaussian kernel that is reflected at 0 and 1. A run that was killed goes on where it stopped.
"""

from __future__ import annotations

import json
import shlex
import sys
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
import torch
import tyro
from jaxtyping import Float
from rich.console import Console
from rich.progress import track
from rich.table import Table
from scipy.stats import norm

import agents
from cp_env.bank import SceneBank
from cp_env.detector import load_detector
from cp_env.scenes import open_source
from cp_env.world import World
from defenders.likelihood import overlaps, read_likelihood
from defenders.protocol import Defender, Frame, Inspection, Query, Verdict

EDGES = (0, 0.025, 0.075, 0.15, 0.25, 0.35, 0.45, 0.55, 0.65, 0.75, 0.85, 1)


@dataclass
class Args:
    scenes: str = "town/calibration"
    n_vehicles: int = 5
    frames: int = 6  # of every scene
    ages: int = 3  # frames between a view and its reference, at most (where nobody lies; else one)
    attack: str = "pgd"
    bandwidth: float = 0.04  # of the kernel
    tail: float = 0.05  # share of every density that is the mean of all
    seed: int = 0
    threads: int = 1
    out: Path = Path("out/likelihood")  # measurements, kept for the next run
    write: Path | None = None


class Surveyor(Defender):
    """An instrument, not a defence: compares every group with every group of the frames before."""

    needs_truth = True  # the referee calls `tell`

    def __init__(self, ages: int) -> None:
        self.ages = ages

    def tell(self, liars: frozenset[int]) -> None:
        self.liars = frozenset(liars)

    def reset(self, n_vehicles: int, rng: np.random.Generator) -> None:
        self.honest = frozenset(range(n_vehicles)) - self.liars
        self.groups = groups(n_vehicles)
        self.past: list[list[object]] = []
        self.measured: list[Float[np.ndarray, "A X X"]] = []  # [age - 1, group, earlier group] of every frame

    def inspect(self, frame: Frame) -> Inspection:
        views = yield Query(self.groups, verification=False)
        found = np.full((self.ages, len(views), len(views)), np.nan)
        for age, earlier in enumerate(reversed(self.past)):
            found[age] = [[frame.similarity(view, reference) for reference in earlier] for view in views]
        self.measured.append(found)
        self.past = [*self.past, views][-(1 if self.liars else self.ages) :]
        return Verdict(self.honest, self.liars)


def groups(n: int) -> list[frozenset[int]]:
    """All groups; group number c - 1 has the members whose bits are set in c."""
    return [frozenset(i for i in range(n) if code >> i & 1) for code in range(1, 2**n)]


@dataclass(frozen=True)
class Tape:
    """One scene, surveyed."""

    liars: frozenset[int]
    similarity: Float[np.ndarray, "T A X X"]  # NaN where there was no frame so long before


def survey(args: Args) -> Iterator[Tape]:
    bank = SceneBank(open_source(args.scenes), load_detector())
    folder = args.out / f"{bank.detector.digest}-{args.attack.replace(':', '-')}-{args.frames}-{args.ages}-{args.seed}"
    folder.mkdir(parents=True, exist_ok=True)
    jobs = list(product(bank.source.names(), range(args.n_vehicles)))
    for number, (scene, k) in enumerate(track(jobs, "surveying")):
        path = folder / f"{scene}-{k}.npz"
        if not path.exists():
            tape = play(args, bank, scene, k, number)
            draft = path.with_suffix(".part.npz")
            np.savez_compressed(draft, liars=sorted(tape.liars), similarity=tape.similarity.astype(np.float32))
            draft.replace(path)
        with np.load(path) as stored:
            yield Tape(frozenset(stored["liars"].astype(int).tolist()), stored["similarity"])


def play(args: Args, bank: SceneBank, scene: str, k: int, number: int) -> Tape:
    world = World(1, defender=Surveyor(args.ages), bank=bank, n_vehicles=args.n_vehicles, n_attackers=k, grace_frames=0)
    world.reset([np.random.SeedSequence([args.seed, number])], options={"scene": scene})
    attacker = agents.make(args.attack if k else "none")
    attacker.reset(1, np.random.default_rng([args.seed, number]))
    for _ in range(args.frames):
        world.step(attacker.act(world.situation()))
    (surveyor,) = world.defenders
    assert isinstance(surveyor, Surveyor)
    return Tape(surveyor.liars, np.array(surveyor.measured))


@dataclass(frozen=True)
class Values:
    """Similarities by kind of comparison."""

    clean: dict[tuple[int, int, int, int], list[np.ndarray]]  # (age, size, size of the reference, both)
    dirty: dict[tuple[int, int], list[np.ndarray]]  # (size, liars), the reference honest and a frame old
    both: list[np.ndarray]


def sorted_out(tapes: Iterator[Tape], n: int) -> Values:
    clean, dirty, both = defaultdict(list), defaultdict(list), list[np.ndarray]()
    everyone = groups(n)
    for tape in tapes:
        known = tape.similarity[1:] if tape.liars else tape.similarity[tape.similarity.shape[1] :]
        for (i, one), (j, other) in product(enumerate(everyone), enumerate(everyone)):
            now, then = len(one & tape.liars), len(other & tape.liars)
            if now and then:
                both.append(known[:, 0, i, j])
            elif now:
                dirty[len(one), now].append(known[:, 0, i, j])
            elif not then:
                for age in range(1 if tape.liars else known.shape[1]):
                    clean[age + 1, len(one), len(other), len(one & other)].append(known[:, age, i, j])
    return Values(dict(clean), dict(dirty), both)


def smoothed(values: list[np.ndarray], bandwidth: float) -> Float[np.ndarray, " B"]:
    """Probability of each bin."""
    x, inner = np.concatenate(values), np.array(EDGES, dtype=float)
    mirrored = np.concatenate([x, -x, 2 - x])
    below = norm.cdf((inner[:, None] - mirrored[None]) / bandwidth).sum(1) / len(x)
    mass = np.diff(below)
    return mass / mass.sum()


def densities(values: Values, args: Args) -> dict[str, object]:
    def row(found: list[np.ndarray]) -> list[float]:
        return smoothed(found, args.bandwidth).round(5).tolist()

    sizes = range(1, args.n_vehicles + 1)
    return {
        "edges": list(EDGES),
        "tail": args.tail,
        "clean": [
            [row(values.clean[age, *kind]) for kind in overlaps(args.n_vehicles)] for age in range(1, args.ages + 1)
        ],
        "dirty": {str(s): {str(d): row(values.dirty[s, d]) for d in sizes if (s, d) in values.dirty} for s in sizes},
        "both": row(values.both),
    }


def report(values: Values, args: Args) -> Table:
    table = Table(
        "group size",
        *(f"{k} liars" for k in range(args.n_vehicles)),
        *(f"age {a}" for a in range(2, args.ages + 1)),
        title="mean similarity (spread) to an honest view of a frame before; of all, of older ages to all, honest",
    )
    for size in range(1, args.n_vehicles + 1):
        found = [
            values.clean[1, size, args.n_vehicles, size],
            *(values.dirty.get((size, d)) for d in range(1, args.n_vehicles)),
        ]
        older = [values.clean[age, size, args.n_vehicles, size] for age in range(2, args.ages + 1)]
        cells = [
            "–" if x is None else f"{np.mean(np.concatenate(x)):.2f} ({np.std(np.concatenate(x)):.2f})"
            for x in found + older
        ]
        table.add_row(str(size), *cells)
    return table


def main(args: Args) -> None:
    torch.set_num_threads(args.threads)
    values = sorted_out(survey(args), args.n_vehicles)
    Console(width=160).print(report(values, args))
    if args.write:
        source = f"{args.scenes}, detector {load_detector().digest}, {args.attack}, {args.frames} frames a scene"
        stored = {"source": source, "command": shlex.join(["python", *sys.argv]), **densities(values, args)}
        args.write.write_text(json.dumps(stored) + "\n")
        read_likelihood(args.write)


if __name__ == "__main__":
    main(tyro.cli(Args))
