"""A defender of your own: 20 lines, from the idea to a figure.

    python examples/add_a_defender.py                  # on scenes, against attackers that lie in every frame
    python examples/add_a_defender.py --perfect        # the idea alone, without a detector: seconds

The idea: whenever the picture jumps, look at each vehicle alone, and fuse those whose view agrees with the last output.
It is honest and dear: n verifications whenever something is wrong.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import tyro

from defenders import Defender, Frame, Inspection, Query, Verdict
from defenders.perfect import play


class OneByOne(Defender):
    """Looks at every vehicle alone when the picture jumps."""

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
        (self.reference,) = yield Query([trusted], verification=False)  # the output of this frame: no extra look
        return Verdict(trusted, set(self.everyone) - trusted)


@dataclass
class Args:
    perfect: bool = False
    """no scenes and no detector: a view is wrong if and only if its group holds a liar"""
    n_attackers: int = 2
    frames: int = 20
    seed: int = 0


def on_the_perfect_world(args: Args) -> None:
    episode = play(OneByOne(), 5, args.n_attackers, args.seed, max_frames=args.frames)
    print(f"lying {sorted(episode.liars)}, accused {sorted(episode.suspects)}, verifications {episode.verifications}")


def on_scenes(args: Args) -> None:
    import cp_env

    env = cp_env.parallel_env(defender=OneByOne(), n_attackers=args.n_attackers, max_frames=args.frames)
    _, infos = env.reset(seed=args.seed)
    rng = np.random.default_rng(args.seed)
    damage, verifications = [], []
    for _ in range(args.frames):
        spaces = {agent: env.action_space(agent) for agent in env.agents}
        actions = {agent: rng.uniform(-1, 1, space.shape).astype(np.float32) for agent, space in spaces.items()}
        _, _, _, truncations, infos = env.step(actions)
        first = infos["adversary_0"]
        damage.append(float(first["damage"]))
        verifications.append(float(first["verifications"]))
        if any(truncations.values()):
            break
    print(f"{len(damage)} frames: damage {np.mean(damage):.2f}, {np.mean(verifications):.1f} verifications a frame")


if __name__ == "__main__":
    args = tyro.cli(Args, description=__doc__)
    on_the_perfect_world(args) if args.perfect else on_scenes(args)
