"""Measure the densities of similarities that `bayes` ships with, by the vehicles fused and the attackers among them.

    python examples/calibrate_likelihood.py                                          # measure and print
    python examples/calibrate_likelihood.py --write defenders/bayes/densities/mean.json    # and ship
    python examples/calibrate_likelihood.py --fusion max --write defenders/bayes/densities/max.json

On the calibration scenes the views of all groups of five vehicles are compared, Eq. (5), with the views of all groups
in the frame before, and with the full view of the same frame. Three kinds of episodes are measured:

* without an attack; then views are also compared with those of two and three frames before;
* under a *loud* attack, PGD, of k = 1 … 4 vehicles, which shows in every view that contains it;
* under *stealthy* attacks of k vehicles, which keep each frame similar to the last; the ego fuses all vehicles.

The first frame is benign. Histograms are smoothed by a Gaussian kernel over arcsin √s, which makes the variance of a
share uniform. The kernel is reflected at both ends. What a similarity says about the *number* of attackers differs from
scene to scene. So each density with attackers is mixed with the mean over their numbers. The density of the full view
is that mean, because it would otherwise be counted in every frame. `--cross` prints the log-likelihood of scenes left
out. A run that was killed goes on where it stopped.
"""

from __future__ import annotations

import json
import shlex
import sys
import zlib
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
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
from cp_env.detector import load_detector
from cp_env.metrics.similarity import view_similarity_many
from cp_env.scenes.subset import SceneSubset
from cp_env.settings import Fusion
from cp_env.types import View
from cp_env.world.scene_cache import SceneBank
from cp_env.world.world import World
from defenders.bayes.histograms import read_likelihood
from defenders.bayes.likelihood import attackers_in_groups, attackers_in_one, overlaps
from defenders.protocol import Defender, Frame, Informed, Inspection, Query, Verdict

EDGES = (0, 0.01, 0.04, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1)
WHAT = ("uncontaminated", "one_contaminated", "both_contaminated", "full_view")
FULL_VIEW_EDGES = (0, 0.02, 0.06, 0.15, 0.3, 0.45, 0.6, 0.8, 1)


@dataclass
class Args:
    scenes: str = "town/calibration+junction/calibration"
    n_scenes: int | None = None  # so many, spread evenly over them (all by default)
    n_vehicles: int = 5
    start: int = 40  # frame of the scene that is the first: at the beginning many egos stand
    frames: int = 7  # of every scene, a benign one first
    ages: int = 3  # frames between a view and its reference, at most (without an attack; else one)
    loud: str = "pgd"  # an attack that shows in every view that contains it
    stealthy: tuple[str, ...] = (
        "in_loop:threshold=0.35,steps=6",
        "in_loop:threshold=0.6,steps=6",
        "ramp:rate=0.3,first=0.2,steps=6",
    )  # attacks that keep the full view similar to the frame before
    fusion: Fusion = "mean"
    bandwidth: float = 0.08  # of the kernel, rad
    numbers: float = 0.3  # share of a density with attackers that is the mean over their numbers
    tail: float = 0.005  # share of every density that is the mean of all
    seed: int = 7
    threads: int = 1
    out: Path = Path("out/likelihood")  # measurements, kept for the next run
    cross: bool = False  # also print the log-likelihood of scenes left out, by kind
    write: Path | None = None


class Surveyor(Defender, Informed):
    """An instrument, no defence: compares all groups with all groups of the frames before, and with the full view."""

    def __init__(self, ages: int, *, fuse_all: bool) -> None:
        """`fuse_all`: the ego fuses all vehicles, as stealthy attacks need; else the benign vehicles."""
        self.ages, self.fuse_all = ages, fuse_all

    def reveal_attackers(self, attackers: frozenset[int]) -> None:
        self.attackers = frozenset(attackers)

    def reset(self, n_vehicles: int, rng: np.random.Generator) -> None:
        self.benign = frozenset(range(n_vehicles)) - self.attackers
        self.groups = groups(n_vehicles)
        self.past: list[list[View]] = []
        self.measured: list[Float[np.ndarray, "A X X"]] = []  # [age - 1, group, earlier group] of every frame
        self.full_view: list[Float[np.ndarray, " X"]] = []

    def inspect(self, frame: Frame) -> Inspection:
        views = yield Query(self.groups)
        found = np.full((self.ages, len(views), len(views)), np.nan)
        for age, earlier in enumerate(reversed(self.past)):
            found[age] = view_similarity_many(list(product(views, earlier))).reshape(found[age].shape)
        self.measured.append(found)
        self.full_view.append(view_similarity_many([(view, frame.seen) for view in views]))
        self.past = [*self.past, views][-(1 if self.attackers else self.ages) :]
        return Verdict(frame.present if self.fuse_all else self.benign)


def groups(n: int) -> list[frozenset[int]]:
    """All groups; group number c - 1 has the members whose bits are set in c."""
    return [frozenset(i for i in range(n) if code >> i & 1) for code in range(1, 2**n)]


@dataclass(frozen=True)
class Measurement:
    """The similarities of one scene under one attack."""

    scene: str
    attack: str
    attackers: frozenset[int]
    similarity: Float[np.ndarray, "T A X X"]  # NaN where there was no frame so long before
    full_view: Float[np.ndarray, "T X"]  # to the full view


def survey(args: Args) -> Iterator[Measurement]:
    bank = SceneBank(SceneSubset(args.scenes, args.n_scenes), load_detector(args.fusion))
    folder = args.out / "-".join(map(str, (bank.detector.digest, args.start, args.frames, args.ages, args.seed)))
    folder.mkdir(parents=True, exist_ok=True)
    attacks = [("none", 0), *product((args.loud, *args.stealthy), range(1, args.n_vehicles))]
    for scene, (attack, k) in track(list(product(bank.source.names(), attacks)), "surveying"):
        path = folder / f"{scene}-{attack.replace(':', '-')}-{k}.npz"
        if not path.exists():
            one = play(args, bank, scene, attack, k)
            draft = path.with_suffix(".part.npz")
            np.savez_compressed(
                draft, attackers=sorted(one.attackers), similarity=one.similarity, full_view=one.full_view
            )
            draft.replace(path)
        with np.load(path) as stored:
            attackers = frozenset(stored["attackers"].astype(int).tolist())
            yield Measurement(scene, attack, attackers, stored["similarity"], stored["full_view"])


def play(args: Args, bank: SceneBank, scene: str, attack: str, k: int) -> Measurement:
    entropy = [args.seed, zlib.crc32(scene.encode()), k, 0]
    instrument = Surveyor(args.ages, fuse_all=attack in args.stealthy)
    world = World(1, defender=instrument, bank=bank, n_vehicles=args.n_vehicles, n_attackers=k, fusion=args.fusion)
    world.reset([np.random.SeedSequence(entropy)], options={"scene": scene, "start": args.start})
    attack_instance = agents.make(attack)
    attack_instance.reset(1, [np.random.default_rng(entropy)])
    for _ in range(args.frames):
        world.step(attack_instance.act(world.situation()))
    (surveyor,) = world.defenders
    assert isinstance(surveyor, Surveyor)
    similarity, full_view = (np.array(found, dtype=np.float32) for found in (surveyor.measured, surveyor.full_view))
    return Measurement(scene, attack, surveyor.attackers, similarity, full_view)


Kind = tuple[str | int, ...]
"""One of

* ("uncontaminated", age, size, size of the reference, vehicles in both),
* ("one_contaminated", mode, size, attackers, size of the uncontaminated reference),
* ("both_contaminated", mode, size, size of the reference),
* ("full_view", mode, size, attackers, attackers in the full view).
"""
Values = dict[Kind, list[np.ndarray]]
Row = Float[np.ndarray, " B"]


def by_kind(measurements: Iterable[Measurement], args: Args) -> Values:
    """Similarities by kind of comparison."""
    values: Values = defaultdict(list)
    everyone, full_view = groups(args.n_vehicles), [0, *modes(args)]
    for measured in measurements:
        mode = 0 if not measured.attackers else 1 if measured.attack == args.loud else 2
        for (i, one), (j, other) in product(enumerate(everyone), enumerate(everyone)):
            now, then = len(one & measured.attackers), len(other & measured.attackers)
            # the reference is benign in the first attacked frame only
            first, later = measured.similarity[1:2, 0, i, j], measured.similarity[2:, 0, i, j]
            overlap = len(one), len(other), len(one & other)
            contaminated = "one_contaminated", mode, len(one), now, len(other)
            values[contaminated if now else ("uncontaminated", 1, *overlap)].append(first)
            if now and then:
                values["both_contaminated", mode, len(one), len(other)].append(later)
            elif now:
                values[contaminated].append(later)
            elif not then:
                values["uncontaminated", 1, *overlap].append(later)
            for age in range(1, 0 if measured.attackers else measured.similarity.shape[1]):
                values["uncontaminated", age + 1, *overlap].append(measured.similarity[age + 1 :, age, i, j])
        for i, one in enumerate(everyone[:-1]):
            for m in full_view if not mode else [mode]:
                values["full_view", m, len(one), len(one & measured.attackers), len(measured.attackers)].append(
                    measured.full_view[1:, i]
                )
    return values


def modes(args: Args) -> range:
    """Modes of attack: loud, and stealthy if there are any such attacks."""
    return range(1, 3 if args.stealthy else 2)


def smoothed(values: list[np.ndarray], edges: Sequence[float], bandwidth: float) -> Row:
    """Probability of each bin."""
    x, inner = (np.arcsin(np.sqrt(np.clip(v, 0, 1))) for v in (np.concatenate(values), np.array(edges, dtype=float)))
    mirrored = np.concatenate([x, -x, np.pi - x])
    below = norm.cdf((inner[:, None] - mirrored[None]) / bandwidth).sum(1) / len(x)
    mass = np.diff(below)
    return mass / mass.sum()


def densities(values: Values, args: Args) -> dict[Kind, Row]:
    """A histogram of every kind."""
    found = {
        kind: smoothed(of, FULL_VIEW_EDGES if kind[0] == "full_view" else EDGES, args.bandwidth)
        for kind, of in values.items()
    }
    return {kind: mixed(found, kind, args) for kind in found}


def mixed(found: dict[Kind, Row], kind: Kind, args: Args) -> Row:
    """The density of a kind with attackers, mixed with the mean over their numbers."""
    if kind[0] == "one_contaminated":
        similar = [row for other, row in found.items() if other[:3] == kind[:3] and other[4] == kind[4]]
        share = 1.0 if kind[2] == args.n_vehicles else args.numbers
    elif kind[0] == "full_view" and kind[4]:
        similar = [row for k, row in found.items() if k[:3] == kind[:3] and k[4] and bool(k[3]) == bool(kind[3])]
        share = args.numbers
    else:
        return found[kind]
    row: Row = (1 - share) * found[kind] + share * np.mean(similar, axis=0)
    return row


def stored(found: dict[Kind, Row], args: Args) -> dict[str, object]:
    """What `read_likelihood` reads."""
    n, listed = args.n_vehicles, {kind: row.round(5).tolist() for kind, row in found.items()}
    sizes, attacks = range(1, n + 1), modes(args)
    return {
        "n_vehicles": n,
        "edges": list(EDGES),
        "tail": args.tail,
        "uncontaminated": [
            [listed["uncontaminated", age, *kind] for kind in overlaps(n)] for age in range(1, args.ages + 1)
        ],
        "one_contaminated": [
            [listed["one_contaminated", m, s, min(d, n - 1), other] for s, d, other in attackers_in_one(n)]
            for m in attacks
        ],
        "both_contaminated": [
            [listed["both_contaminated", m, *kind] for kind in product(sizes, sizes)] for m in attacks
        ],
        "full_view_edges": list(FULL_VIEW_EDGES),
        "full_view": [[listed["full_view", m, *kind] for kind in attackers_in_groups(n)] for m in attacks],
    }


def left_out(measurements: list[Measurement], args: Args) -> dict[str, float]:
    """Mean log-likelihood of each scene's similarities under the densities of the others.

    All kinds and scenes have the same weight.
    """
    scores = defaultdict(list)
    for scene in sorted({one.scene for one in measurements}):
        known = densities(by_kind((one for one in measurements if one.scene != scene), args), args)
        mean = {what: np.mean([row for kind, row in known.items() if kind[0] == what], axis=0) for what in WHAT}
        for kind, values in by_kind((one for one in measurements if one.scene == scene), args).items():
            edges = np.array(FULL_VIEW_EDGES if kind[0] == "full_view" else EDGES)[1:-1]
            row = (1 - args.tail) * known[kind] + args.tail * mean[str(kind[0])]
            bins = np.searchsorted(edges, np.concatenate(values), side="right")
            scores[str(kind[0])].append(float(np.log(row[bins]).mean()))
    return {what: float(np.mean(scores[what])) for what in WHAT}


def report(values: Values, args: Args) -> Table:
    n = args.n_vehicles
    table = Table(
        "group size",
        "no attack",
        *(f"{k} {mode}" for mode in ("loud", "stealthy")[: len(modes(args))] for k in range(1, n)),
        *(f"age {a}" for a in range(2, args.ages + 1)),
        title="mean similarity (spread) to a benign view of a frame before; without an attack, to the full view",
    )
    for size in range(1, n + 1):
        uncontaminated = [[("uncontaminated", age, size, n, size)] for age in range(1, args.ages + 1)]
        contaminated = [
            [("one_contaminated", m, size, d, other) for other in range(1, n + 1)]
            for m in modes(args)
            for d in range(1, n)
        ]
        cells = [
            [x for kind in kinds for x in values.get(kind, [])]
            for kinds in [uncontaminated[0], *contaminated, *uncontaminated[1:]]
        ]
        found = [np.concatenate(cell) if cell else None for cell in cells]
        table.add_row(str(size), *("–" if x is None else f"{x.mean():.2f} ({x.std():.2f})" for x in found))
    return table


def main(args: Args) -> None:
    torch.set_num_threads(args.threads)
    measurements = list(survey(args))
    values = by_kind(measurements, args)
    console = Console(width=160)
    console.print(report(values, args))
    if args.cross:
        console.print({what: round(score, 3) for what, score in left_out(measurements, args).items()})
    if args.write:
        attacks = " ".join([args.loud, *args.stealthy])
        source = (
            f"{args.n_scenes or 'all'} scenes of {args.scenes}, detector {load_detector(args.fusion).digest}, "
            f"{attacks}, {args.frames} frames a scene"
        )
        about = {"source": source, "command": shlex.join(["python", *sys.argv])}
        table = {**about, **stored(densities(values, args), args)}
        args.write.write_text(json.dumps(table) + "\n")
        read_likelihood(args.write)


if __name__ == "__main__":
    main(tyro.cli(Args))
