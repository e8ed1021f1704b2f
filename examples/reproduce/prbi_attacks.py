"""Attacks on the defence itself, under a verifier that sees every lie: every serious defender, PRBI also corrected.

    python examples/reproduce/prbi_attacks.py                                    # PRBI in four versions, and the others
    python examples/reproduce/prbi_attacks.py --defenders prbi mine.BestPair     # any defenders

"all along" is the paper's attack. "first frame": the frame that the paper trusts is a lie too. "every 3", "every 5":
all lie in every third or fifth frame (Table 6). "turncoat": one of the liars is honest until frame 20. "out of step":
one liar lies always, the others in every third frame. "all but one", "nobody": k = 4, and k = 0 for 1,000 frames.
"framing": one vehicle's lie shows only in groups with vehicle 0, which is honest: no verdict on groups tells the two
apart. "appears": one of the liars is not there before frame 20. "drops out": an honest vehicle is away in frames 2 to
21. "comes and goes": the liars are there in every third frame only, and lie then.

sure: share of the episodes that have converged in the last frame; right: where exactly the liars are accused then; ID
and MC: share of the liars and of the innocents accused then; fooled: frames of 40 (1,000) in which the ego acted on a
view that was wrong; looks: verifications a frame, and the most in any.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from rich.console import Console
from rich.progress import track
from rich.table import Table

from cp_env.evaluation.execution.rollout import open_defender
from defenders import Defender
from defenders.simulation.statistics import Tally, members, play_many
from defenders.simulation.verifier import Group
from defenders.simulation.world import Schedule, Terms, every, turning

FIVE = Terms(n_vehicles=5, n_liars=2, max_frames=40, until_converged=False)


def out_of_step(frame: int, liars: Group) -> Group:
    """The first of them always lies, the others in every third frame."""
    return liars if frame % 3 == 0 else frozenset(sorted(liars)[:1])


def framing(group: Group, lying: Group, rng: np.random.Generator) -> float:
    """The lie shows in groups that hold vehicle 0, and nowhere else."""
    return float(not lying or 0 not in group)


def late(frame: int, liars: Group) -> Group:
    """The liar of highest number is not there before frame 20."""
    return frozenset(sorted(liars)[-1:]) if frame < 20 else frozenset()


def holiday(frame: int, liars: Group) -> Group:
    """The honest vehicle of lowest number, but never the ego, is away in the frames 2 to 21."""
    return frozenset({min({1, 2, 3, 4} - liars)}) if 2 <= frame < 22 else frozenset()


def seldom_there(frame: int, liars: Group) -> Group:
    """The liars, but never the ego, are away in two of three frames."""
    return liars - {0} if (frame - 1) % 3 else frozenset()


def absent(who: Schedule, **knobs: Any) -> Terms:
    return replace(FIVE, absent=who, **knobs)


SITUATIONS = {
    "all along": FIVE,
    "first frame": replace(FIVE, grace_frames=0),
    "every 3": replace(FIVE, schedule=every(3, start=1)),
    "every 5": replace(FIVE, schedule=every(5, start=1)),
    "turncoat": replace(FIVE, schedule=turning(20)),
    "out of step": replace(FIVE, schedule=out_of_step),
    "all but one": replace(FIVE, n_liars=4),
    "nobody": replace(FIVE, n_liars=0, max_frames=1000),
    "framing": replace(FIVE, n_liars=1, honest={0}, likeness=framing),
    "appears": absent(late),
    "drops out": absent(holiday),
    "comes and goes": absent(seldom_there, schedule=every(3, start=1)),
}
PRBI = ("prbi", "prbi:rearm=True", "prbi:stopping=robust", "prbi:stopping=robust,rearm=True")
OTHERS = ("robosac", "pasac:score=similarity", "bayes:likelihood=perfect")


@dataclass
class Args:
    episodes: int = 100
    """of each situation; of those of 1,000 frames, one in 25"""
    seed: int = 0
    defenders: tuple[str, ...] = (*PRBI, *OTHERS)
    out: Path = Path("out/prbi/attacks.json")


@dataclass(frozen=True)
class Row:
    sure: float
    right: float
    ID: float | None
    MC: float
    fooled: float  # frames an episode
    looks: float  # a frame
    most: int


def measure(defender: Defender, terms: Terms, episodes: int, seed: int) -> Row:
    tally = play_many(defender, terms, episodes=max(episodes * 40 // terms.max_frames, 1), seed=seed)
    return Row(
        sure=float(tally.converged.mean()),
        right=float(tally.solved.mean()),
        ID=float(tally.identified.mean()) if terms.n_liars else None,
        MC=float(tally.wronged.mean()),
        fooled=float(fooled(tally, terms).sum(axis=1).mean()),
        looks=float(tally.all_verifications.mean()),
        most=int(tally.all_verifications.max()),
    )


def fooled(tally: Tally, terms: Terms) -> np.ndarray:
    """Whether the output of a frame was wrong [E, T]."""
    wrong = tally.deceived > 0
    return wrong & members(tally.fused, tally.n_vehicles)[..., 0] if terms.likeness is framing else wrong


def main(args: Args) -> None:
    rows = {
        f"{situation} | {name}": measure(open_defender(name), terms, args.episodes, args.seed)
        for situation, terms in track(SITUATIONS.items(), "playing", transient=True)
        for name in args.defenders
    }
    table = Table("lies", "defender", "sure", "right", "ID", "MC", "fooled", "looks", "most")
    for i, (key, row) in enumerate(rows.items(), 1):
        situation, name = key.split(" | ")
        shares = [f"{x:.2f}" if x is not None else "–" for x in (row.sure, row.right, row.ID, row.MC)]
        figures = [*shares, f"{row.fooled:.1f}", f"{row.looks:.2f}", str(row.most)]
        table.add_row(situation, name, *figures, end_section=i % len(args.defenders) == 0)
    Console(width=120).print(table)
    args.out.parent.mkdir(parents=True, exist_ok=True)
    args.out.write_text(json.dumps({key: vars(row) for key, row in rows.items()}, indent=1) + "\n")
    print("written:", args.out)


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
