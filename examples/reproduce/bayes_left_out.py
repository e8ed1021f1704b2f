"""`bayes` and PRBI on measured similarities of the shipped detector, calibrated without the scene that is played.

    python examples/calibrate_likelihood.py          # measures, if that was not done
    python examples/reproduce/bayes_left_out.py

`calibrate_likelihood.py` compares the view of every group with the views of all groups in the frame before, and with
the full view of its own frame, while PGD attacks in k = 0 … 4 of five vehicles. A defender that compares nothing else
can be replayed on these similarities exactly, because PGD does not depend on the defender. The stealthy attacks that
are measured as well depend on it. They are not replayed, but they are in the densities. The densities of `bayes` are
those of the other scenes. PRBI's thresholds by size were calibrated on scenes of the same splits, which is an
advantage.

Frames to convergence: over the episodes that converge within the six measured frames. ID rate and MC rate: share of the
attackers and of the benign vehicles that are flagged then, or else in the last frame. Attackers fused: frames of six in
which an attacker is fused. Verifications: per frame, in the first abnormal frame, and the most in any frame.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).parents[2]))  # the calibration is another example

from agents.calibration.comparisons import Measurement, all_groups
from agents.calibration.densities import by_kind, densities, part_of
from cp_env.metrics.intervals import t_interval
from defenders import Bayes, Defender, Prbi, Verdict
from defenders.bayes.histograms import likelihood_of
from defenders.bayes.likelihood import Likelihood
from examples.calibrate_likelihood import Args as Calibration
from examples.calibrate_likelihood import measured as measure

Seen = tuple[int, int]  # frame, number of the group


@dataclass
class Args:
    calibration: Calibration = field(default_factory=Calibration)
    seed: int = 0


@dataclass(frozen=True)
class MeasuredFrame:
    """One measured frame as a defender sees it. A similarity to a view older than measured is that to the oldest."""

    measured: Measurement
    index: int
    n_vehicles: int

    @property
    def present(self) -> frozenset[int]:
        return frozenset(range(self.n_vehicles))

    @property
    def seen(self) -> Seen:
        return self.index, 2**self.n_vehicles - 2

    def similarity(self, a: Seen, b: Seen) -> float:
        (then, reference), (now, group) = sorted([a, b])
        if then == now:
            return float(self.measured.full_view[now, min(reference, group)])
        ages = self.measured.similarity[now, : now - then, group, reference]
        return float(ages[~np.isnan(ages)][-1])

    def agreement(self, a: Seen, b: Seen) -> float:
        """ValueError: it was not measured."""
        raise ValueError("score maps were not measured; replay defenders that compare boxes")


@dataclass(frozen=True)
class Replay:
    attackers: frozenset[int]
    verdicts: list[Verdict]
    verifications: list[int]


def play(defender: Defender, measured: Measurement, n: int, seed: int) -> Replay:
    """Replay a measurement to a defender, frame by frame, and count its verifications."""
    number = {group: i for i, group in enumerate(all_groups(n))}
    played = Replay(measured.attackers, [], [])
    defender.reset(n, np.random.default_rng(seed))
    for t in range(len(measured.similarity)):
        inspection, verifications = defender.inspect(MeasuredFrame(measured, t, n)), 0
        try:
            query = next(inspection)
            while True:
                verifications += len(query.groups) if query.verification else 0
                query = inspection.send([(t, number[group]) for group in query.groups])
        except StopIteration as stop:
            played.verdicts.append(stop.value)
        played.verifications.append(verifications)
    return played


def row(name: str, k: int, episodes: Sequence[Replay]) -> list[str]:
    """Figures of some episodes; the first frame is benign and not counted."""
    converged = [next((t for t, v in enumerate(e.verdicts) if v.converged), None) for e in episodes]
    final = [e.verdicts[-1 if t is None else t].suspects for e, t in zip(episodes, converged, strict=True)]
    after = [t for t in converged if t is not None]
    benign = len(episodes) * (5 - k)
    verifications = np.array([e.verifications[1:] for e in episodes])
    fused = [sum(bool(v.collaborators & e.attackers) for v in e.verdicts[1:]) for e in episodes]
    interval = t_interval(after) if len(after) > 1 else None
    spread = f" ± {(interval.high - interval.low) / 2:.1f}" if interval else ""
    return [
        str(k),
        name,
        f"{len(after)} of {len(episodes)}",
        f"{np.mean(after):.2f}{spread}" if after else "–",
        f"{sum(len(s & e.attackers) for s, e in zip(final, episodes, strict=True)) / max(len(episodes) * k, 1):.2f}",
        f"{sum(len(s - e.attackers) for s, e in zip(final, episodes, strict=True)) / benign:.2f}",
        f"{np.mean(fused):.2f}",
        f"{verifications.mean():.2f}",
        f"{verifications[:, 0].mean():.2f}",
        str(verifications.max()),
    ]


def likelihood_without(measurements: Sequence[Measurement], scene: str, calibration: Calibration) -> Likelihood:
    """The densities of all scenes but one."""
    episodes, smoothing = calibration.episodes, calibration.smoothing
    values = by_kind((one for one in measurements if one.scene != scene), episodes)
    return likelihood_of(part_of(densities(values, episodes.n_vehicles, smoothing), episodes, smoothing.tail))


def main(args: Args) -> None:
    measurements, episodes = measure(args.calibration), args.calibration.episodes
    scenes = {one.scene for one in measurements}
    known = {scene: likelihood_without(measurements, scene, args.calibration) for scene in scenes}
    players: dict[str, Callable[[Measurement], Defender]] = {
        "prbi": lambda one: Prbi(),
        "prbi:threshold=calibrated": lambda one: Prbi(threshold="calibrated"),
        "bayes": lambda one: Bayes(likelihood=known[one.scene]),
    }
    columns = (
        "k",
        "defender",
        "converged",
        "frames to convergence",
        "ID rate (TPR)",
        "MC rate (FPR)",
        "attackers fused",
        "verifications/frame",
        "first abnormal frame",
        "max. verifications",
    )
    table = Table(*columns, title=f"{len(known)} scenes, {episodes.frames - 1} frames of PGD each")
    n = episodes.n_vehicles
    for k in range(n):
        for name, make in players.items():
            mine = [one for one in measurements if len(one.attackers) == k and one.attack not in episodes.stealthy]
            table.add_row(*row(name, k, [play(make(one), one, n, args.seed) for one in mine]))
        table.add_section()
    Console(width=120).print(table)


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
