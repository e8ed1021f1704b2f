"""Play learned attackers on traffic they never saw, beside random actions and PGD on every frame: a table and a GIF.

python examples/play_attacker.py                                   # the policy that ships with the package
python examples/play_attacker.py --policies runs/prbi-*/policy.safetensors
"""

from __future__ import annotations

import json
import operator
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
import torch
import tyro
from rich.console import Console
from rich.progress import track
from rich.table import Table

import agents
from agents.episodes import Episodes, Player, begin, by_attacker, by_chance, by_policy, play
from agents.policy import Policy, load_policy
from cp_env.camera import Camera
from cp_env.game import Game
from cp_env.intervals import Interval, t_interval
from cp_env.rendering import write_gif


@dataclass
class Args:
    policies: list[str] = field(default_factory=lambda: ["prbi"])
    """names of shipped policies, or .safetensors files; several of one recipe are its training seeds"""
    scenes: str = "town/test"
    n_scenes: int = 20
    """the first so many scenes, one episode each"""
    worlds: int = 10
    """worlds stepped together; divides n_scenes"""
    seed: int = 0
    """of the liars and of all noise, the same for every attacker"""
    out: Path = Path("runs/play")
    """folder of attackers.json, attackers.md and attacker.gif"""
    gif_frames: int = 100
    """length of the GIF; 0 for none"""


def main(args: Args) -> None:
    torch.set_num_threads(1)
    policies = [load_policy(name) for name in args.policies]
    _agree(policies)
    game = Game(args.worlds, policies[0].defender, scenes=args.scenes, **policies[0].knobs)
    scenes = game.world.bank.source.names()[: args.n_scenes]
    players: dict[str, list[Player]] = {
        "nobody lies": [by_attacker(agents.make("none"))],
        "random actions": [by_chance],
        "PGD on every frame": [by_attacker(agents.make("pgd"))],
        "PGD on whom the ego fused last": [by_attacker(agents.make("pgd", audience="fused"))],
        f"PPO ({len(policies)} training seed{'s' * (len(policies) > 1)})": [by_policy(policy) for policy in policies],
    }
    total = sum(map(len, players.values()))
    jobs = track([(name, p) for name, row in players.items() for p in row], "playing", total=total)
    played: dict[str, list[Episodes]] = {name: [] for name in players}
    for name, player in jobs:
        played[name].append(play(game, player, scenes, args.seed))
    args.out.mkdir(parents=True, exist_ok=True)
    _report(played, policies[0].defender, args)
    if args.gif_frames:
        _film(policies[0], game, scenes[0], args)


def _agree(policies: list[Policy]) -> None:
    if any((p.defender, p.knobs) != (policies[0].defender, policies[0].knobs) for p in policies):
        raise ValueError(
            "the policies were trained under different knobs or against different defenders; play them apart"
        )


def _report(played: dict[str, list[Episodes]], defender: str, args: Args) -> None:
    """Intervals over training seeds where there are several, else over scenes."""
    title = f"against {defender} on {args.n_scenes} scenes of {args.scenes}, 95 % intervals"
    table = Table(
        "attacker", "damage per episode", "liars left out", "similarity", "verifications a frame", title=title
    )
    rows = {}
    for name, runs in played.items():
        figures = [
            _interval(runs, operator.attrgetter(key))
            for key in ("damage", "excluded", "similarity", "verifications")
        ]
        table.add_row(name, format(figures[0], ".1f"), *(format(figure, ".2f") for figure in figures[1:]))
        rows[name] = {"damage": asdict(figures[0]), "by_run": [run.damage.tolist() for run in runs]}
    Console().print(table)
    (args.out / "attackers.json").write_text(json.dumps(rows, indent=1))


def _interval(runs: list[Episodes], figure: Callable[[Episodes], np.ndarray]) -> Interval:
    return t_interval([figure(run).mean() for run in runs] if len(runs) > 1 else figure(runs[0]))


def _film(policy: Policy, game: Game, scene: str, args: Args) -> None:
    single = Game(1, policy.defender, bank=game.world.bank, **policy.knobs)
    move = by_policy(policy)(single, begin(single, [scene], args.seed), [])
    camera, pictures = Camera(single.world), []
    for _ in track(range(min(args.gif_frames, single.settings.max_frames)), "filming"):
        outcome = move()
        camera.watch(outcome)
        pictures.append(camera.shoot())
        if outcome.truncated[0]:
            break
    Console().print(f"wrote {write_gif(pictures, args.out / 'attacker.gif')}")


if __name__ == "__main__":
    main(tyro.cli(Args))
