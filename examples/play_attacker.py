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
from agents.policy import Policy, load_policy, policy_names
from agents.scenes import Some
from cp_env.camera import Camera
from cp_env.game import Game
from cp_env.intervals import Interval, t_interval
from cp_env.rendering import write_gif

HEADINGS = {
    "damage per episode": "damage",
    "liars left out": "excluded",
    "similarity": "similarity",
    "verifications a frame": "verifications",
}


@dataclass
class Args:
    policies: list[str] = field(default_factory=lambda: [name for name in policy_names() if name.startswith("prbi-")])
    """names of shipped policies, or .safetensors files: the training seeds of one recipe"""
    scenes: str = "town/test"
    n_scenes: int = 15
    """how many of them, one episode each"""
    worlds: int = 5
    """worlds stepped together; divides n_scenes"""
    seed: int = 0
    """of the liars and of all noise, the same for every attacker"""
    out: Path = Path("runs/play")
    """folder of attackers.json and attacker.gif"""
    gif_frames: int = 100
    """length of the GIF; 0 for none"""


def main(args: Args) -> None:
    torch.set_num_threads(1)
    policies = [load_policy(name) for name in args.policies]
    _agree(policies)
    source = Some(args.scenes, args.n_scenes)
    scenes = source.names()
    game = Game(args.worlds, policies[0].defender, scenes=source, **policies[0].knobs)
    players: dict[str, list[Player]] = {
        "nobody lies": [by_attacker(agents.make("none"))],
        "random actions": [by_chance],
        "PGD on every frame": [by_attacker(agents.make("pgd"))],
        "PGD on whom the ego fused last": [by_attacker(agents.make("pgd", audience="fused"))],
        "PPO": [by_policy(policy) for policy in policies],
    }
    jobs = [(name, player) for name, row in players.items() for player in row]
    played: dict[str, list[Episodes]] = {name: [] for name in players}
    for name, player in track(jobs, "playing"):
        played[name].append(play(game, player, scenes, args.seed))
    args.out.mkdir(parents=True, exist_ok=True)
    _report(played, policies[0].defender, args)
    if args.gif_frames:
        best = max(policies, key=lambda policy: policy.notes.get("holdout_damage", 0.0))
        _film(best, game, scenes[-1], args)


def _agree(policies: list[Policy]) -> None:
    if any((p.defender, p.knobs) != (policies[0].defender, policies[0].knobs) for p in policies):
        raise ValueError(
            "the policies were trained under different knobs or against different defenders; play them apart"
        )


def _report(played: dict[str, list[Episodes]], defender: str, args: Args) -> None:
    """Intervals over training seeds where there are several, else over scenes; then PPO and the rest scene by scene."""
    title = f"against {defender} on {args.n_scenes} scenes of {args.scenes}, 95 % intervals"
    table = Table("attacker", "runs", *HEADINGS, title=title)
    rows: dict[str, dict[str, object]] = {}
    learned = np.mean([run.damage for run in played["PPO"]], axis=0)
    for name, runs in played.items():
        figures = [_interval(runs, operator.attrgetter(key)) for key in HEADINGS.values()]
        table.add_row(
            name, str(len(runs)), format(figures[0], ".1f"), *(format(figure, ".2f") for figure in figures[1:])
        )
        rows[name] = {key: asdict(figure) for key, figure in zip(HEADINGS.values(), figures, strict=True)}
        rows[name]["damage by run and scene"] = [run.damage.tolist() for run in runs]
        if name != "PPO":
            rows[name]["PPO does more"] = asdict(t_interval(learned - runs[0].damage))
    console = Console()
    console.print(table)
    for name in ("random actions", "PGD on every frame"):
        more = t_interval(learned - played[name][0].damage)
        console.print(f"PPO does {format(more, '.1f')} more damage per episode than {name} (paired by scene)")
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
