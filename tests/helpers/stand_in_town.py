"""A stand-in for the recorded town: its scenes' names, with a few frames of the toy crossing behind each."""

from __future__ import annotations

from collections.abc import Sequence

from cp_env import lidar
from cp_env.scenes import Town
from cp_env.types import Scene, Sweep
from tests.helpers.toy_scenes import toy_scene

FRAMES = 6


class Sketch:
    """A split of the town; every scene is turned a little."""

    def __init__(self, split: str = "train") -> None:
        self.name, self.digest = f"town/{split}", f"sketch-{FRAMES}-{lidar.DIGEST}"
        self._names = Town(split).names()

    def names(self) -> tuple[str, ...]:
        return self._names

    def load(self, name: str) -> Scene:
        return toy_scene(name=name, n_frames=FRAMES, yaw=0.1 * self._names.index(name))

    def sweeps(self, scene: Scene, frames: Sequence[int]) -> list[list[Sweep]]:
        return lidar.scan([(scene, frame) for frame in frames])
