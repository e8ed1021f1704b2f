"""`bayes` beside PRBI on similarities as the detector that ships measured them, each scene judged by the other scenes'.

    python examples/calibrate_likelihood.py          # measures, if that was not done
    python examples/reproduce/bayes_left_out.py

Every group's view of the calibration scenes was compared with every group's of the frame before, and with everyone's of
its own frame, while PGD lay in k = 0 … 4 of five vehicles (`calibrate_likelihood.py` keeps them). A defender that
compares nothing else can be replayed on them exactly, since PGD heeds no defender (the quiet liars that are measured
there as well do, and are left out here, but not out of the densities). The densities of `bayes` are those
of the other eleven scenes; PRBI's thresholds by size were calibrated on these very scenes, which helps it.

after: frames of attack until the defender is sure, of the episodes in which it is within the six measured; ID and MC:
liars and innocents accused then, or in the last frame; fooled: frames in which a liar is fused; looks: verifications a
frame, in the first abnormal frame, and the most in any.
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).parents[2]))  # the calibration is another example

from cp_env.metrics.intervals import t_interval
from defenders import Bayes, Defender, Prbi, Verdict
from defenders.bayes.histograms import read_likelihood
from defenders.bayes.likelihood import Likelihood
from examples.calibrate_likelihood import Args as Calibration
from examples.calibrate_likelihood import Tape, densities, groups, sorted_out, stored, survey

Seen = tuple[int, int]  # frame, number of the group


@dataclass
class Args:
    calibration: Calibration = field(default_factory=Calibration)
    seed: int = 0


@dataclass(frozen=True)
class Shown:
    """One frame of a tape, as a defender sees it. A similarity to a view older than measured is that to the oldest."""

    tape: Tape
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
            return float(self.tape.beside[now, min(reference, group)])
        ages = self.tape.similarity[now, : now - then, group, reference]
        return float(ages[~np.isnan(ages)][-1])

    def agreement(self, a: Seen, b: Seen) -> float:
        """ValueError: it was not measured."""
        raise ValueError("score maps were not measured; replay defenders that compare boxes")


@dataclass(frozen=True)
class Played:
    liars: frozenset[int]
    verdicts: list[Verdict]
    looks: list[int]


def play(defender: Defender, tape: Tape, n: int, seed: int) -> Played:
    """Show a tape to a defender, frame by frame, and count."""
    number = {group: i for i, group in enumerate(groups(n))}
    played = Played(tape.liars, [], [])
    defender.reset(n, np.random.default_rng(seed))
    for t in range(len(tape.similarity)):
        inspection, looks = defender.inspect(Shown(tape, t, n)), 0
        try:
            query = next(inspection)
            while True:
                looks += len(query.groups) if query.verification else 0
                query = inspection.send([(t, number[group]) for group in query.groups])
        except StopIteration as stop:
            played.verdicts.append(stop.value)
        played.looks.append(looks)
    return played


def row(name: str, k: int, episodes: Sequence[Played]) -> list[str]:
    """Figures of some episodes; the first frame is honest and not counted."""
    sure = [next((t for t, v in enumerate(e.verdicts) if v.converged), None) for e in episodes]
    final = [e.verdicts[-1 if t is None else t].suspects for e, t in zip(episodes, sure, strict=True)]
    after = [t for t in sure if t is not None]
    innocent = len(episodes) * (5 - k)
    looks = np.array([e.looks[1:] for e in episodes])
    fooled = [sum(bool(v.collaborators & e.liars) for v in e.verdicts[1:]) for e in episodes]
    interval = t_interval(after) if len(after) > 1 else None
    spread = f" ± {(interval.high - interval.low) / 2:.1f}" if interval else ""
    return [
        str(k),
        name,
        f"{len(after)} of {len(episodes)}",
        f"{np.mean(after):.2f}{spread}" if after else "–",
        f"{sum(len(s & e.liars) for s, e in zip(final, episodes, strict=True)) / max(len(episodes) * k, 1):.2f}",
        f"{sum(len(s - e.liars) for s, e in zip(final, episodes, strict=True)) / innocent:.2f}",
        f"{np.mean(fooled):.2f}",
        f"{looks.mean():.2f}",
        f"{looks[:, 0].mean():.2f}",
        str(looks.max()),
    ]


def likelihood_without(tapes: Sequence[Tape], scene: str, calibration: Calibration) -> Likelihood:
    """The densities of all scenes but one."""
    values = sorted_out((tape for tape in tapes if tape.scene != scene), calibration)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "likelihood.json"
        path.write_text(json.dumps(stored(densities(values, calibration), calibration)))
        return read_likelihood(path)


def main(args: Args) -> None:
    tapes = list(survey(args.calibration))
    known = {scene: likelihood_without(tapes, scene, args.calibration) for scene in {tape.scene for tape in tapes}}
    players: dict[str, Callable[[Tape], Defender]] = {
        "prbi": lambda tape: Prbi(),
        "prbi:threshold=calibrated": lambda tape: Prbi(threshold="calibrated"),
        "bayes": lambda tape: Bayes(likelihood=known[tape.scene]),
    }
    columns = ("k", "defender", "sure", "after", "ID", "MC", "fooled", "looks", "at first", "most")
    table = Table(*columns, title=f"{len(known)} scenes, {args.calibration.frames - 1} frames of PGD each")
    n = args.calibration.n_vehicles
    for k in range(n):
        for name, make in players.items():
            mine = [tape for tape in tapes if len(tape.liars) == k and tape.attack not in args.calibration.quiet]
            table.add_row(*row(name, k, [play(make(tape), tape, n, args.seed) for tape in mine]))
        table.add_section()
    Console(width=120).print(table)


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
