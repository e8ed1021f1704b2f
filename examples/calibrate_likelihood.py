"""How probable is a similarity, given who was fused and who of them lied? The densities that `bayes` ships with.

    python examples/calibrate_likelihood.py                                          # measure and print
    python examples/calibrate_likelihood.py --write defenders/bayes/densities/mean.json    # and ship
    python examples/calibrate_likelihood.py --fusion max --write defenders/bayes/densities/max.json

On the calibration scenes the views of every group of five vehicles are compared, Eq. (5), with those of every group
the frame before, and with that of everyone in the same frame: while nobody lies (then also with those of two and three
frames before); while PGD lies jointly in k = 1 … 4 vehicles, which shows (*loud*); and while k lie so that each frame
resembles the last (*quiet*), to an ego that is fooled. The first frame is honest. Histograms are smoothed by a
Gaussian kernel over arcsin √s, which evens out the spread of a share, reflected at both ends. What a similarity says on
the *number* of liars differs from scene to scene, and what everyone's view says would be counted in every frame: so
each density with liars is mixed with the mean over their numbers, and that of everyone's view is that mean. `--cross`
prints the log-likelihood of scenes left out. A run that was killed goes on where it stopped.
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
from cp_env.evaluation import parse
from cp_env.metrics.similarity import view_similarity_many
from cp_env.scenes import open_source
from cp_env.types import View
from cp_env.world.scene_cache import SceneBank
from cp_env.world.world import World
from defenders.bayes.histograms import read_likelihood
from defenders.bayes.likelihood import liars_in_groups, liars_in_one, overlaps
from defenders.protocol import Defender, Frame, Inspection, Query, Verdict

EDGES = (0, 0.01, 0.04, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1)
WHAT = ("clean", "dirty", "both", "beside")
BESIDE_EDGES = (0, 0.02, 0.06, 0.15, 0.3, 0.45, 0.6, 0.8, 1)


@dataclass
class Args:
    scenes: str = "town/calibration"
    n_vehicles: int = 5
    start: int = 20  # frame of the scene that is the first
    frames: int = 7  # of every scene, an honest one first
    ages: int = 3  # frames between a view and its reference, at most (where nobody lies; else one)
    loud: str = "pgd"  # lies that show
    quiet: tuple[str, ...] = (
        "in_loop:threshold=0.35,steps=6",
        "in_loop:threshold=0.6,steps=6",
        "ramp:rate=0.3,first=0.2,steps=6",
    )  # lies that resemble the frame before
    fusion: str = "mean"
    bandwidth: float = 0.08  # of the kernel, rad
    numbers: float = 0.3  # share of a density with liars that is the mean over their numbers
    tail: float = 0.005  # share of every density that is the mean of all
    seed: int = 7
    threads: int = 1
    out: Path = Path("out/likelihood")  # measurements, kept for the next run
    cross: bool = False  # also print the log-likelihood of scenes left out, by kind
    write: Path | None = None


class Surveyor(Defender):
    """An instrument, not a defence: compares every group with every group of the frames before, and with everyone."""

    needs_truth = True  # the referee calls `tell`

    def __init__(self, ages: int, *, fooled: bool) -> None:
        """`fooled`: the ego acts on everyone's view, lies or not, as quiet liars need; else on that of the honest."""
        self.ages, self.fooled = ages, fooled

    def tell(self, liars: frozenset[int]) -> None:
        self.liars = frozenset(liars)

    def reset(self, n_vehicles: int, rng: np.random.Generator) -> None:
        self.honest = frozenset(range(n_vehicles)) - self.liars
        self.groups = groups(n_vehicles)
        self.past: list[list[View]] = []
        self.measured: list[Float[np.ndarray, "A X X"]] = []  # [age - 1, group, earlier group] of every frame
        self.beside: list[Float[np.ndarray, " X"]] = []

    def inspect(self, frame: Frame) -> Inspection:
        views = yield Query(self.groups, verification=False)
        found = np.full((self.ages, len(views), len(views)), np.nan)
        for age, earlier in enumerate(reversed(self.past)):
            found[age] = view_similarity_many(list(product(views, earlier))).reshape(found[age].shape)
        self.measured.append(found)
        self.beside.append(view_similarity_many([(view, frame.seen) for view in views]))
        self.past = [*self.past, views][-(1 if self.liars else self.ages) :]
        return Verdict(frame.present if self.fooled else self.honest)


def groups(n: int) -> list[frozenset[int]]:
    """All groups; group number c - 1 has the members whose bits are set in c."""
    return [frozenset(i for i in range(n) if code >> i & 1) for code in range(1, 2**n)]


@dataclass(frozen=True)
class Tape:
    """One scene, surveyed."""

    scene: str
    attack: str
    liars: frozenset[int]
    similarity: Float[np.ndarray, "T A X X"]  # NaN where there was no frame so long before
    beside: Float[np.ndarray, "T X"]  # to everyone's view


def survey(args: Args) -> Iterator[Tape]:
    bank = SceneBank(open_source(args.scenes), load_detector(args.fusion))
    folder = args.out / "-".join(map(str, (bank.detector.digest, args.start, args.frames, args.ages, args.seed)))
    folder.mkdir(parents=True, exist_ok=True)
    casts = [("none", 0), *product((args.loud, *args.quiet), range(1, args.n_vehicles))]
    for scene, (attack, k) in track(list(product(bank.source.names(), casts)), "surveying"):
        path = folder / f"{scene}-{attack.replace(':', '-')}-{k}.npz"
        if not path.exists():
            tape = play(args, bank, scene, attack, k)
            draft = path.with_suffix(".part.npz")
            np.savez_compressed(draft, liars=sorted(tape.liars), similarity=tape.similarity, beside=tape.beside)
            draft.replace(path)
        with np.load(path) as stored:
            liars = frozenset(stored["liars"].astype(int).tolist())
            yield Tape(scene, attack, liars, stored["similarity"], stored["beside"])


def play(args: Args, bank: SceneBank, scene: str, attack: str, k: int) -> Tape:
    entropy = [args.seed, zlib.crc32(scene.encode()), k, 0]
    instrument = Surveyor(args.ages, fooled=attack in args.quiet)
    world = World(1, defender=instrument, bank=bank, n_vehicles=args.n_vehicles, n_attackers=k, fusion=args.fusion)
    world.reset([np.random.SeedSequence(entropy)], options={"scene": scene, "start": args.start})
    name, knobs = parse(attack)
    attacker = agents.make(name, **knobs)
    attacker.reset(1, [np.random.default_rng(entropy)])
    for _ in range(args.frames):
        world.step(attacker.act(world.situation()))
    (surveyor,) = world.defenders
    assert isinstance(surveyor, Surveyor)
    similarity, beside = (np.array(found, dtype=np.float32) for found in (surveyor.measured, surveyor.beside))
    return Tape(scene, attack, surveyor.liars, similarity, beside)


Kind = tuple[str | int, ...]
"""("clean", age, size, size of the reference, both), ("dirty", manner, size, liars, size of the honest reference),
("both", manner, size, size of the reference) or ("beside", manner, size, liars, liars of everyone)."""
Values = dict[Kind, list[np.ndarray]]
Row = Float[np.ndarray, " B"]


def sorted_out(tapes: Iterable[Tape], args: Args) -> Values:
    """Similarities by kind of comparison."""
    values: Values = defaultdict(list)
    everyone, beside = groups(args.n_vehicles), [0, *manners(args)]
    for tape in tapes:
        manner = 0 if not tape.liars else 1 if tape.attack == args.loud else 2
        for (i, one), (j, other) in product(enumerate(everyone), enumerate(everyone)):
            now, then = len(one & tape.liars), len(other & tape.liars)
            first, later = tape.similarity[1:2, 0, i, j], tape.similarity[2:, 0, i, j]  # honest reference, or not
            overlap = len(one), len(other), len(one & other)
            lie = "dirty", manner, len(one), now, len(other)
            values[lie if now else ("clean", 1, *overlap)].append(first)
            if now and then:
                values["both", manner, len(one), len(other)].append(later)
            elif now:
                values[lie].append(later)
            elif not then:
                values["clean", 1, *overlap].append(later)
            for age in range(1, 0 if tape.liars else tape.similarity.shape[1]):
                values["clean", age + 1, *overlap].append(tape.similarity[age + 1 :, age, i, j])
        for i, one in enumerate(everyone[:-1]):
            for m in beside if not manner else [manner]:
                values["beside", m, len(one), len(one & tape.liars), len(tape.liars)].append(tape.beside[1:, i])
    return values


def manners(args: Args) -> range:
    """Of lies: the loud, and the quiet if there are any."""
    return range(1, 3 if args.quiet else 2)


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
        kind: smoothed(of, BESIDE_EDGES if kind[0] == "beside" else EDGES, args.bandwidth)
        for kind, of in values.items()
    }
    return {kind: mixed(found, kind, args) for kind in found}


def mixed(found: dict[Kind, Row], kind: Kind, args: Args) -> Row:
    """The density of a kind with liars, mixed with the mean over their numbers."""
    if kind[0] == "dirty":
        alike = [row for other, row in found.items() if other[:3] == kind[:3] and other[4] == kind[4]]
        share = 1.0 if kind[2] == args.n_vehicles else args.numbers
    elif kind[0] == "beside" and kind[4]:
        alike = [row for k, row in found.items() if k[:3] == kind[:3] and k[4] and bool(k[3]) == bool(kind[3])]
        share = args.numbers
    else:
        return found[kind]
    row: Row = (1 - share) * found[kind] + share * np.mean(alike, axis=0)
    return row


def stored(found: dict[Kind, Row], args: Args) -> dict[str, object]:
    """What `read_likelihood` reads."""
    n, listed = args.n_vehicles, {kind: row.round(5).tolist() for kind, row in found.items()}
    sizes, lies = range(1, n + 1), manners(args)
    return {
        "n_vehicles": n,
        "edges": list(EDGES),
        "tail": args.tail,
        "clean": [[listed["clean", age, *kind] for kind in overlaps(n)] for age in range(1, args.ages + 1)],
        "dirty": [[listed["dirty", m, s, min(d, n - 1), other] for s, d, other in liars_in_one(n)] for m in lies],
        "both": [[listed["both", m, *kind] for kind in product(sizes, sizes)] for m in lies],
        "beside_edges": list(BESIDE_EDGES),
        "beside": [[listed["beside", m, *kind] for kind in liars_in_groups(n)] for m in lies],
    }


def left_out(tapes: list[Tape], args: Args) -> dict[str, float]:
    """Mean log-likelihood of each scene's similarities under the densities of the others; kinds and scenes alike."""
    scores = defaultdict(list)
    for scene in sorted({tape.scene for tape in tapes}):
        known = densities(sorted_out((tape for tape in tapes if tape.scene != scene), args), args)
        mean = {what: np.mean([row for kind, row in known.items() if kind[0] == what], axis=0) for what in WHAT}
        for kind, values in sorted_out((tape for tape in tapes if tape.scene == scene), args).items():
            edges = np.array(BESIDE_EDGES if kind[0] == "beside" else EDGES)[1:-1]
            row = (1 - args.tail) * known[kind] + args.tail * mean[str(kind[0])]
            bins = np.searchsorted(edges, np.concatenate(values), side="right")
            scores[str(kind[0])].append(float(np.log(row[bins]).mean()))
    return {what: float(np.mean(scores[what])) for what in WHAT}


def report(values: Values, args: Args) -> Table:
    n = args.n_vehicles
    table = Table(
        "group size",
        "nobody lies",
        *(f"{k} {manner}" for manner in ("loud", "quiet")[: len(manners(args))] for k in range(1, n)),
        *(f"age {a}" for a in range(2, args.ages + 1)),
        title="mean similarity (spread) to an honest view of a frame before; where nobody lies to that of everyone",
    )
    for size in range(1, n + 1):
        clean = [[("clean", age, size, n, size)] for age in range(1, args.ages + 1)]
        lies = [[("dirty", m, size, d, other) for other in range(1, n + 1)] for m in manners(args) for d in range(1, n)]
        cells = [[x for kind in kinds for x in values.get(kind, [])] for kinds in [clean[0], *lies, *clean[1:]]]
        found = [np.concatenate(cell) if cell else None for cell in cells]
        table.add_row(str(size), *("–" if x is None else f"{x.mean():.2f} ({x.std():.2f})" for x in found))
    return table


def main(args: Args) -> None:
    torch.set_num_threads(args.threads)
    tapes = list(survey(args))
    values = sorted_out(tapes, args)
    console = Console(width=160)
    console.print(report(values, args))
    if args.cross:
        console.print({what: round(score, 3) for what, score in left_out(tapes, args).items()})
    if args.write:
        attacks = " ".join([args.loud, *args.quiet])
        source = f"{args.scenes}, detector {load_detector(args.fusion).digest}, {attacks}, {args.frames} frames a scene"
        about = {"source": source, "command": shlex.join(["python", *sys.argv])}
        table = {**about, **stored(densities(values, args), args)}
        args.write.write_text(json.dumps(table) + "\n")
        read_likelihood(args.write)


if __name__ == "__main__":
    main(tyro.cli(Args))
