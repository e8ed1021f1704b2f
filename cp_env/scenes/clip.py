"""The beginning of every scene of a source: for previews, miniatures and tests."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from cp_env.types import Scene, SceneSource, Sweep


class Clip:
    """The first `frames` frames of each scene of `source`, and of its connected vehicles the first `vehicles`.

    Raises:
        ValueError: fewer than one frame or vehicle is asked for.
    """

    def __init__(self, source: SceneSource, *, frames: int | None = None, vehicles: int | None = None) -> None:
        for what, number in (("frames", frames), ("vehicles", vehicles)):
            if number is not None and number < 1:
                raise ValueError(f"{what} must be at least 1, not {number}")
        self._source, self._frames, self._vehicles = source, frames, vehicles
        self.name = source.name
        self.digest = f"{source.digest}-{frames}-{vehicles}"

    def names(self) -> tuple[str, ...]:
        return self._source.names()

    def load(self, name: str) -> Scene:
        scene = self._source.load(name)
        return replace(scene, pose=scene.pose[: self._frames], connected=scene.connected[: self._vehicles])

    def sweeps(self, scene: Scene, frames: Sequence[int]) -> list[list[Sweep]]:
        whole = self._source.load(scene.name)
        taken = self._source.sweeps(whole, frames)
        return [sweeps[: scene.n_connected] + sweeps[whole.n_connected :] for sweeps in taken]
