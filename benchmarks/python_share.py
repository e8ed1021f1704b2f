"""Python's share of a step, with a detector that costs nothing:

    python -m benchmarks.python_share                     # 256 worlds against PRBI
    python -m benchmarks.python_share --num-envs 16 64 --profile cumtime

The detector's maps have one channel, and its outputs were computed before: a view is a row of them. So what is left is
the world's own work: poses, masks, views, defenders and their queries, matching, verdicts, measures and infos. Boxes
were made before, too, unless `--boxes` asks for them; then suppression and the search for peaks count as well.

In every fourth frame the outputs are those of other scenes, so that defenders verify, and hold more ghosts than an
attack makes. Processor time, one thread, `town/test`, medians over rounds.
"""

from __future__ import annotations

import cProfile
import pstats
import statistics
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
import tyro
from torch import Tensor

from cp_env.detector.model.base import BaseDetector
from cp_env.detector.model.decoder import Dense
from cp_env.detector.registry import open_detector
from cp_env.envs.core import Game
from cp_env.scenes import open_source
from cp_env.scenes.clip import Clip
from cp_env.types import Detections, Sweep
from cp_env.world.allocator import keep_freed_memory
from cp_env.world.scene_cache import SceneBank
from cp_env.world.world import World

STORED = 1024
"""Outputs that were computed before; the boxes of each, too."""
OTHERS = 4
"""One frame in so many shows other scenes."""


@dataclass(frozen=True)
class Args:
    """What is timed."""

    num_envs: tuple[int, ...] = (256,)
    defender: str = "prbi"
    frames: int = 12
    rounds: int = 3
    boxes: bool = False  # make them anew of every view
    profile: str = ""  # print where the time goes, sorted by "tottime" or "cumtime"


class Costless(BaseDetector):
    """Answers with stored outputs: view b of a frame is row b of them, or another in frames of other scenes."""

    channels = 1
    shift: int

    def __init__(self, stored: Dense, *, boxes: bool) -> None:
        super().__init__()
        self.logits, self.box_codes = stored.logits, stored.boxes
        self.anew, self.shift = boxes, 0
        self.made = super().detect(stored)

    @property
    def digest(self) -> str:
        return "costless"

    def encode(self, sweeps: Sequence[Sweep]) -> Tensor:
        return torch.zeros(len(sweeps), 1, self.size, self.size)

    def perceive(self, received: Tensor, coverage: Tensor, world: Tensor, groups: Tensor) -> Dense:
        rows = slice(self.shift, self.shift + len(world))
        return Dense(self.logits[rows], self.box_codes[rows])

    def detect(self, dense: Dense, own: np.ndarray | None = None) -> list[Detections]:
        if self.anew:
            return super().detect(dense, own)
        return self.made[self.shift : self.shift + len(dense.logits)]


def stored_outputs() -> Dense:
    """Outputs of the detector that ships, of real frames."""
    bank = SceneBank(Clip(open_source("town/test"), frames=6), open_detector(), progress=False)
    world = World(16, bank=bank, max_frames=6)
    world.reset(list(range(16)))
    clean = world.situation().clean
    return Dense(clean.logits.repeat(STORED // 16, 1, 1), clean.boxes.repeat(STORED // 16, 1, 1, 1))


@dataclass(frozen=True)
class Share:
    """Milliseconds a world-frame; verifications a world-frame."""

    world: float  # `situation` and `step`
    environment: float  # the action, the step, reward, observation and infos
    verifications: float


def measure(num_envs: int, args: Args) -> Share:
    """Both in turn, on the same detector."""
    detector = Costless(stored_outputs(), boxes=args.boxes)
    detector.freeze()
    bank = SceneBank(open_source("town/test"), detector, progress=False)
    game = Game(
        num_envs, args.defender, bank=bank, action="basis", observation="compact", knowledge="gray-box", max_frames=100
    )
    slots = (num_envs, len(game.slots), *game.single_action_space.shape)
    actions = np.random.default_rng(0).uniform(-1, 1, slots).astype(np.float32)
    delta = torch.zeros(num_envs, len(game.slots), 1, detector.size, detector.size)
    asked: list[float] = []

    def world_alone() -> None:
        game.world.situation()
        asked.append(float(np.mean(game.world.step(delta).verifications)))

    def environment() -> None:
        game.step(actions)

    times: list[list[float]] = []
    for _ in range(1 + args.rounds):
        parts: list[float] = []
        for one in (world_alone, environment):
            game.reset(list(range(num_envs)))
            profile = cProfile.Profile() if args.profile and one is environment and len(times) == args.rounds else None
            start = time.process_time()
            if profile:
                profile.enable()
            for t in range(args.frames):
                detector.shift = STORED // 3 + t if t % OTHERS == OTHERS - 1 else 0
                one()
            if profile:
                profile.disable()
            parts.append(1e3 * (time.process_time() - start) / (num_envs * args.frames))
            if profile:
                pstats.Stats(profile).sort_stats(args.profile).print_stats(40)
        times.append(parts)
    world, whole = (statistics.median(column) for column in zip(*times[1:], strict=True))
    return Share(world, whole, float(np.mean(asked)))


def main(args: Args) -> None:
    torch.set_num_threads(1)
    keep_freed_memory()
    for num_envs in args.num_envs:
        share = measure(num_envs, args)
        print(
            f"E = {num_envs}, {args.defender}, {share.verifications:.2f} verifications a world-frame: "
            f"{share.world:.2f} ms a world-frame, with actions, observations and infos {share.environment:.2f}"
        )


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
