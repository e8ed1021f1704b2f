"""A defender of your own in 20 lines, from the idea to a result.

    python examples/add_a_defender.py                  # on scenes, with attackers that perturb every frame
    python examples/add_a_defender.py --perfect        # the idea alone, without a detector: seconds

The idea: whenever the picture jumps, verify each vehicle alone, and fuse those whose view agrees with the last output.
It trusts no vehicle without a verification, and it is expensive: n verifications whenever the picture jumps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import tyro

from defenders import Defender, Frame, Inspection, Query, Verdict
from defenders.simulation.world import play


class OneByOne(Defender):
    """Verifies every vehicle alone when the picture jumps."""

    def __init__(self, epsilon: float = 0.3) -> None:
        self.epsilon = epsilon

    def reset(self, n_vehicles: int, rng: np.random.Generator) -> None:
        self.everyone, self.reference = range(n_vehicles), None

    def inspect(self, frame: Frame) -> Inspection:
        if self.reference is None or frame.similarity(frame.seen, self.reference) >= self.epsilon:
            self.reference = frame.seen
            return Verdict(self.everyone)
        views = yield Query([{i} for i in self.everyone])
        trusted = {i for i in self.everyone if frame.similarity(views[i], self.reference) >= self.epsilon} or {0}
        (self.reference,) = yield Query([trusted], verification=False)  # this frame's output: no extra verification
        return Verdict(trusted, set(self.everyone) - trusted)


ALL_OUT = np.array([1, 0, 0, 0, 0, 1, 1, 1], dtype=np.float32)  # the guided action at full strength, aimed everywhere


@dataclass
class Args:
    perfect: bool = False
    """no scenes and no detector: a view is wrong if and only if its group holds an attacker"""
    n_attackers: int = 2
    frames: int = 20
    seed: int = 0


def on_the_perfect_world(args: Args) -> None:
    episode = play(OneByOne(), 5, args.n_attackers, args.seed, max_frames=args.frames)
    print(f"attackers {sorted(episode.attackers)}, flagged {sorted(episode.suspects)}", end=", ")
    print(f"verifications {episode.verifications}")


def on_scenes(args: Args) -> None:
    import cp_env

    env = cp_env.parallel_env(
        defender=OneByOne(), scenes="town/test", n_attackers=args.n_attackers, max_frames=args.frames
    )
    env.reset(seed=args.seed)
    damage: list[float] = []
    verifications: list[float] = []
    while len(damage) < args.frames:
        infos = env.step(dict.fromkeys(env.agents, ALL_OUT))[-1]
        damage.append(float(infos["adversary_0"]["damage"]))
        verifications.append(float(infos["adversary_0"]["verifications"]))
    print(f"{len(damage)} frames: damage {np.mean(damage):.2f}, {np.mean(verifications):.1f} verifications a frame")


if __name__ == "__main__":
    args = tyro.cli(Args, description=__doc__)
    on_the_perfect_world(args) if args.perfect else on_scenes(args)
