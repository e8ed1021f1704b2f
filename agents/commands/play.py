"""What every attack costs each defender on traffic not trained on: scripted attacks, and learned ones.

    cp-play                                                      # every defender that a policy ships for
    cp-play --defenders prbi --policies runs/prbi-1/policy.safetensors
    cp-play --defenders prbi --gif-frames 100
    cp-play --scenes mine:Folder:folder=data --weights runs/mine/mean.safetensors --n-scenes 2

Each attack's episodes are kept in a file under --out; started again, it goes on with those that are missing.
One episode as a film: cp-env play.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np
from rich.console import Console

from agents.arena.entries import make_attack
from agents.commands.common import Victim, run_program
from agents.learning.policy import load_policy, policy_names
from agents.learning.rollout import Episodes, open_bank, play, slug
from cp_env.evaluation import Conditions, Run
from cp_env.evaluation.plan.files import write_atomically
from cp_env.evaluation.plan.runs import file_words
from cp_env.evaluation.report.video import record_episode, write_film
from cp_env.metrics.intervals import Interval, t_interval
from cp_env.metrics.shares import share_interval
from cp_env.progress import say, track

HEADINGS = {
    "detection loss/frame": "damage",
    "critical recall lost": "critical",
    "attackers excluded": "excluded",
    "verifications/frame": "verifications",
}
COMMON = ("pgd", "random", "ramp:rate=0.3,first=0.2,steps=8")

THRESHOLD_AWARE = {
    "prbi": "in_loop:threshold=0.35,steps=8",
    "robosac": "in_loop:reference=ego,threshold=0.3,steps=8",
    "pasac:score=similarity": "in_loop:reference=ego,groups=halves,threshold=0.37,steps=6",
    "bayes": "in_loop:threshold=0.6,steps=8",
}
"""What each defender compares, its threshold-aware attack knows; see examples/reproduce/adaptive_attacks.py."""

SHIPPED = {name: load_policy(name).defender for name in policy_names()}
"""The defender that each shipped policy was trained against."""

Played = dict[tuple[str, str], Episodes]
"""By defender and attack."""


@dataclass(frozen=True)
class Args(Victim):
    """What attacks cost."""

    defenders: tuple[str, ...] = tuple(sorted(set(SHIPPED.values())))
    """the defenders they meet"""
    attacks: tuple[str, ...] = ()
    """scripted ones, specs such as pgd:steps=30; if none is given, COMMON and the one of THRESHOLD_AWARE"""
    policies: tuple[str, ...] = ()
    """learned ones, names or .safetensors files; if none is given, those that ship for the defender"""
    scenes: str = "town/test"
    n_scenes: int = 3
    """how many of them, one episode each"""
    batch: int = 3
    """worlds stepped together"""
    frames: int = 50
    """length of an episode"""
    vehicles: int = 5
    """n, vehicles that share their maps"""
    rsu: bool = False
    """with the road-side unit's map as the last one; one vehicle is enough then"""
    k: int = 2
    """attackers among them"""
    seed: int = 0
    """of starts, attackers and noise, the same for every attack"""
    out: Path = Path("runs/play")
    """folder of episodes, attacks.json and attacks.md"""
    gif_frames: int = 0
    """also make a video of the first policy against the first defender"""


def conditions_of(args: Args) -> Conditions:
    """The conditions of all episodes."""
    source = open_bank(args.scenes, args.n_scenes, args.spec, args.fusion).source
    return Conditions(
        scenes=source,
        names=source.names(),
        frames=args.frames,
        n_vehicles=args.vehicles,
        rsu=args.rsu,
        fusion=args.fusion,
    )


def play_all(args: Args, conditions: Conditions) -> Played:
    """Every attack against every defender."""
    runs = [(d, spec) for d in args.defenders for spec in [*learned(d, args), *scripted(d, args)]]
    say(
        f"plan: {len(runs)} attacks on {len(args.defenders)} defenders, {args.n_scenes} episodes of {args.frames} "
        "frames each, one process; the time left is told after the first"
    )
    return {run: _episodes(*run, conditions, args) for run in track(runs, "playing", unit="attack")}


def scripted(defender: str, args: Args) -> list[str]:
    """Specs of the scripted attacks."""
    return list(args.attacks) or [*(spec for met, spec in THRESHOLD_AWARE.items() if met == defender), *COMMON]


def learned(defender: str, args: Args) -> list[str]:
    """Specs of the policies that meet a defender."""
    return [f"policy:name={n}" for n in args.policies or [n for n, d in SHIPPED.items() if d == defender]]


def _episodes(defender: str, spec: str, conditions: Conditions, args: Args) -> Episodes:
    """The attack's episodes, from the disk if they are there."""
    bank = open_bank(args.scenes, args.n_scenes, args.spec, args.fusion)
    attack = make_attack(spec)
    asked = {"attack": spec, **conditions.describe(), "k": args.k, "seed": args.seed, "detector": bank.detector.digest}
    asked["trained"] = getattr(attack, "notes", None)  # a policy trained anew under its old name is another one
    path = args.out / slug(defender) / f"{file_words(spec)}.json"
    asked["measures"] = [one.name for one in fields(Episodes)]
    if path.exists():
        stored = json.loads(path.read_text())
        if stored["asked"] == asked:
            return Episodes(**{key: np.array(values) for key, values in stored["episodes"].items()})
    episodes = play(attack, conditions, bank, defender=defender, k=args.k, seed=args.seed, batch=args.batch)
    write_atomically(path, json.dumps({"asked": asked, "episodes": _lists(episodes)}))
    return episodes


def _lists(episodes: Episodes) -> dict[str, list[float]]:
    return {key: values.tolist() for key, values in asdict(episodes).items()}


def report(played: Played, defender: str, args: Args) -> Iterator[str]:
    """Markdown: 95 % intervals over scenes; then each policy against the worst scripted attack, paired by scene.

    Shares have Gaffke's interval, which stays in [0, 1]; verifications have Student's, cut at 0; differences Student's,
    and the critical recall that was lost is one: of the output's and the clean view's.
    """
    yield f"\nAgainst {defender}, {args.n_scenes} scenes of {args.scenes}, {args.frames} frames, k = {args.k}:\n"
    yield f"| attack | {' | '.join(HEADINGS)} |"
    yield f"|---|{'---|' * len(HEADINGS)}"
    rows = {spec: episodes for (d, spec), episodes in played.items() if d == defender}
    for spec, episodes in rows.items():
        damage, *others = [_interval(episodes, key) for key in HEADINGS.values()]
        yield f"| {spec} | {format(damage, '.3f')} | {' | '.join(format(figure, '.2f') for figure in others)} |"
    yield ""
    worst = max(scripted(defender, args), key=lambda spec: float(rows[spec].damage.mean()))
    for spec in learned(defender, args):
        more = t_interval(rows[spec].damage - rows[worst].damage)
        yield f"{spec} does {format(more, '.3f')} more per frame than {worst}, paired by scene."


def _interval(episodes: Episodes, key: str) -> Interval:
    """The mean over scenes: a count for verifications, a difference for critical recall, else a share."""
    values = getattr(episodes, key)
    if key == "critical":
        return t_interval(values)
    return t_interval(values, least=0.0) if key == "verifications" else share_interval(values)


def write(played: Played, args: Args) -> str:
    """Write attacks.md and attacks.json; returns the Markdown."""
    text = "\n".join(line for defender in args.defenders for line in report(played, defender, args))
    write_atomically(args.out / "attacks.md", text + "\n")
    rows = [{"defender": d, "attack": a, **_lists(e)} for (d, a), e in played.items()]
    write_atomically(args.out / "attacks.json", json.dumps(rows, indent=1))
    return text


def film(args: Args, conditions: Conditions) -> Path:
    """The video of the first attack against the first defender in the last scene."""
    defender = args.defenders[0]
    attack = [*learned(defender, args), *scripted(defender, args)][0]
    run = Run(defender, attack, args.k, args.seed, conditions.names[-1:])
    bank = open_bank(args.scenes, args.n_scenes, args.spec, args.fusion)
    return write_film(record_episode(run, conditions, bank, make_attack, args.gif_frames), args.out / "attack.gif")


def program(args: Args, command: str) -> None:
    """Play, write, and show."""
    del command
    conditions = conditions_of(args)
    Console().print(write(play_all(args, conditions), args), markup=False, highlight=False, soft_wrap=True)
    if args.gif_frames:
        Console().print(f"wrote {film(args, conditions)}", soft_wrap=True)


def main(argv: list[str] | None = None) -> None:
    """Run the console script; `argv` are the command line's unless given."""
    run_program("cp-play", Args, program, __doc__, argv)


if __name__ == "__main__":
    main()
