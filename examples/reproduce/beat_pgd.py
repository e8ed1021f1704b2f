"""How long it takes to learn an attack that beats PGD against PRBI: seconds and frames.

    python examples/reproduce/beat_pgd.py                        # guided actions, 16 worlds, one torch thread
    python examples/reproduce/beat_pgd.py --precision bfloat16 --seed 1

PPO learns on scenes of `town/train`. After every `--every` frames its policy plays the scenes of `town/calibration`,
one episode each, with the starts and attackers that PGD had there. It beats PGD if its damage is higher by the paired
comparison, p < 0.05. Since that is asked again and again, a policy that does is asked once more, on other starts and
attackers: only if it wins there too is the clock stopped. The clock counts learning alone; what the evaluations take is
said beside it.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
import torch
import tyro
from jaxtyping import Float

import agents
from agents.learning.ppo import export, make_ppo
from agents.learning.rollout import open_bank, play
from agents.sb3 import make_vec_env
from cp_env.detector.registry import precise
from cp_env.evaluation import Attack, Conditions, Learned
from cp_env.evaluation.analysis.comparisons import LEVEL, paired_difference
from cp_env.metrics.intervals import Interval
from cp_env.settings import Action, Knowledge, Precision
from cp_env.world.allocator import keep_freed_memory


@dataclass(frozen=True)
class Args:
    """An attack that beats PGD."""

    defender: str = "prbi"
    attack: str = "pgd"  # the attack to beat
    action: Action = "guided"
    knowledge: Knowledge = "gray-box"
    precision: Precision = "float32"
    worlds: int = 16
    n_scenes: int = 12  # to learn on
    n_held_out: int = 12  # to evaluate on
    max_frames: int = 50  # of an episode
    every: int = 2048  # frames between evaluations, all worlds together
    most: int = 65_536  # frames after which it gives up
    n_steps: int = 64  # frames of each world in a rollout
    seed: int = 0
    threads: int = 1  # of torch


@dataclass(frozen=True)
class Course:
    """When an attack was beaten, if it was."""

    beaten: bool
    frames: int
    learning: float  # seconds by the clock
    processor: float  # seconds of it that the processor worked
    evaluating: float  # seconds by the clock


class Comparison:
    """Damage of an attack and of the one to beat, on the same episodes."""

    def __init__(self, args: Args) -> None:
        self.args, self.bank = args, open_bank("town/calibration", args.n_held_out, precise("cp_env", args.precision))
        self.conditions = Conditions(self.bank.source, self.bank.source.names(), args.max_frames)
        self.to_beat = [self._damage(agents.make(args.attack), seed) for seed in range(2)]

    def _damage(self, attack: Attack | Learned, seed: int) -> Float[np.ndarray, " n"]:
        return play(attack, self.conditions, self.bank, defender=self.args.defender, seed=seed).damage

    def ahead(self, attack: Learned, seed: int) -> tuple[bool, Interval]:
        """Whether it does more damage, and by how much; `seed` decides starts and attackers."""
        interval, p = paired_difference(self._damage(attack, seed), self.to_beat[seed])
        return interval.mean > 0 and p < LEVEL, interval


def race(args: Args) -> Course:
    """Learn until the attack is beaten."""
    options = {"action": args.action, "knowledge": args.knowledge, "max_frames": args.max_frames}
    victim = precise("cp_env", args.precision)
    env = make_vec_env(
        args.worlds,
        args.defender,
        bank=open_bank("town/train", args.n_scenes, victim),
        **options,  # type: ignore[arg-type]
    )
    comparison = Comparison(args)
    print(f"{args.attack} against {args.defender}: damage {comparison.to_beat[0].mean():.3f} a frame", flush=True)
    model = make_ppo(env, args.seed, n_steps=args.n_steps)
    learning = processor = evaluating = 0.0
    beaten = False
    while not beaten and model.num_timesteps < args.most * env.n_seats:
        start, worked = time.perf_counter(), time.process_time()
        model.learn(args.every * env.n_seats, reset_num_timesteps=False)
        middle = time.perf_counter()
        learning, processor = learning + middle - start, processor + time.process_time() - worked
        policy = export(model, args.defender, {"observation": "compact", **options}, seed=args.seed)
        beaten, gain = comparison.ahead(policy, 0)
        frames = model.num_timesteps // env.n_seats
        print(f"{frames} frames, {learning:.0f} s: {gain:+.3f} a frame more than {args.attack}", flush=True)
        if beaten:
            beaten, gain = comparison.ahead(policy, 1)
            print(f"  on other starts and attackers: {gain:+.3f}", flush=True)
        evaluating += time.perf_counter() - middle
    return Course(beaten, model.num_timesteps // env.n_seats, learning, processor, evaluating)


def main(args: Args) -> None:
    torch.set_num_threads(args.threads)
    keep_freed_memory()
    course = race(args)
    verdict = "beaten" if course.beaten else "not beaten"
    print(
        f"{args.attack} was {verdict} after {course.frames} frames and {course.learning:.0f} s of learning "
        f"({course.processor:.0f} s of the processor), besides {course.evaluating:.0f} s of evaluation"
    )


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
