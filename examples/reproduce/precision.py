"""The detector in bfloat16 beside single precision: AP, damage, verifications, similarities, and PGD's strength.

    python examples/reproduce/precision.py --out out/precision

Both play the same scenes, attackers and starts of PGD. A figure in bfloat16 is said to agree if it lies in the 95 %
interval of the figure in single precision. PGD that searches in bfloat16 is also played against the victim in single
precision. Run it again to go on where it stopped.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from jaxtyping import Float
from rich.console import Console
from rich.progress import Progress

import agents
from agents.arena.conditions import spread
from agents.attacks.cached import CachedAttack
from cp_env import evaluation
from cp_env.evaluation import Conditions, Record
from cp_env.evaluation.analysis.comparisons import paired_difference
from cp_env.metrics.intervals import Interval, t_interval
from cp_env.metrics.shares import share_interval
from cp_env.scenes import open_source
from cp_env.settings import PRECISIONS

LINES = (
    ("none", "none"),
    ("ego_only", "none"),
    ("prbi", "none"),
    ("bayes", "none"),
    ("none", "pgd"),
    ("prbi", "pgd"),
    ("bayes", "pgd"),
)
"""Defender and attack."""

ROUNDED = "pgd:precision=bfloat16"
BINS = np.linspace(0, 1, 11)
Played = dict[tuple[str, str, str], list[Record]]
"""By precision, defender and attack: one record a scene."""


@dataclass(frozen=True)
class Args:
    """bfloat16 beside single precision."""

    scenes: str = "town/test"
    n_scenes: int | None = None  # spread evenly over the list; all by default
    frames: int = 20  # of each
    k: int = 2  # attackers
    seed: int = 0
    workers: int = 1
    out: Path = Path("out/precision")


@lru_cache(maxsize=8)
def make_attack(name: str, **options: Any) -> evaluation.Attack:
    """PGD knows of no defence: its answers are kept from one defender to the next."""
    return CachedAttack(agents.make(name, **options))


def play(args: Args) -> Played:
    """Play what is not there yet."""
    names = spread(open_source(args.scenes).names(), args.n_scenes)
    workers = evaluation.Workers(make_attack=make_attack, processes=args.workers)
    played: Played = {}
    with Progress(console=Console(stderr=True)) as progress:
        for precision in PRECISIONS:
            conditions = Conditions(args.scenes, names, args.frames, precision=precision)  # type: ignore[arg-type]
            store = evaluation.Store(args.out, evaluation.open_bank(conditions).detector.digest)
            lines = (*LINES, *([("none", ROUNDED)] if precision == "float32" else []))
            for defender, attack in lines:
                runs = evaluation.plan_runs(
                    conditions, defenders=[defender], attacks=[attack], ks=[args.k], seeds=[args.seed], batch=4
                )
                bar = progress.add_task(f"{precision} {defender} {attack}", total=len(runs))
                for _ in evaluation.execute(runs, conditions, store, workers):
                    progress.advance(bar)
                found = store.load(runs, conditions)
                played[precision, defender, attack] = [record for records in found.values() for record in records]
    return played


def report(played: Played) -> Iterator[str]:
    """The tables."""
    yield "| defender | attack | figure | float32 | bfloat16 | difference, paired by scene | agrees |"
    yield "|---|---|---|---|---|---|---|"
    for defender, attack in LINES:
        exact, rounded = (played[precision, defender, attack] for precision in ("float32", "bfloat16"))
        for name, value, interval, spec in FIGURES:
            yield _row(f"{defender} | {attack} | {name}", value(exact), value(rounded), interval, spec)
    yield ""
    yield "| similarity | " + " | ".join(f"{low:.1f}" for low in BINS[:-1]) + " | differs |"
    yield "|---|" + "--:|" * len(BINS)
    for attack in ("none", "pgd"):
        shares = {p: _histogram(played[p, "none", attack]) for p in ("float32", "bfloat16")}
        apart = 0.5 * np.abs(shares["float32"] - shares["bfloat16"]).sum()
        for precision, share in shares.items():
            yield f"| {attack}, {precision} | " + " | ".join(f"{s:.3f}" for s in share) + f" | {apart:.4f} |"
    yield ""
    searched = [_damage(played["float32", "none", attack]) for attack in ("pgd", ROUNDED)]
    difference, _ = paired_difference(searched[1], searched[0])
    yield (
        f"PGD against the victim in single precision, undefended: damage {searched[0].mean():.4f} if it searches in "
        f"single precision, {searched[1].mean():.4f} in bfloat16: {difference:+.4f} a frame."
    )


def _row(
    what: str,
    exact: Float[np.ndarray, " n"],
    rounded: Float[np.ndarray, " n"],
    interval: Callable[[Float[np.ndarray, " n"]], Interval],
    spec: str,
) -> str:
    here, difference = interval(exact), paired_difference(rounded, exact)[0]
    agrees = "yes" if here.low <= rounded.mean() <= here.high else "no"
    return f"| {what} | {here:{spec}} | {rounded.mean():{spec}} | {difference:+{spec}} | {agrees} |"


def _damage(records: Sequence[Record]) -> Float[np.ndarray, " n"]:
    return np.array([np.mean(record.damage[record.grace_frames :]) for record in records])


def _verifications(records: Sequence[Record]) -> Float[np.ndarray, " n"]:
    return np.array([np.mean(record.verifications[record.grace_frames :]) for record in records])


def _ap(iou: float) -> Callable[[Sequence[Record]], Float[np.ndarray, " n"]]:
    return lambda records: np.array([record.meter.value(iou) for record in records])


def _histogram(records: Sequence[Record]) -> Float[np.ndarray, " bins"]:
    """Shares of the frames by the similarity of everyone's view to the output before."""
    values = np.concatenate([record.similarity[1:] for record in records])
    return np.histogram(values, BINS)[0] / len(values)


FIGURES = (
    ("AP@0.5, mean of scenes", _ap(0.5), share_interval, ".3f"),
    ("AP@0.7, mean of scenes", _ap(0.7), share_interval, ".3f"),
    ("damage a frame", _damage, share_interval, ".3f"),
    ("verifications a frame", _verifications, t_interval, ".2f"),
)
"""Name, value of each scene, interval, how it is printed."""


def main(args: Args) -> None:
    """Play and print."""
    print("\n".join(report(play(args))))


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
