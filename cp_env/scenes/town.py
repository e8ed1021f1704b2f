"""The scenes that ship with the package: recorded traffic of two regimes, each in three splits that share no street.

`town` has three kinds of streets and five to eight connected vehicles strung out along them. `junction` has eight round
one crossing: what one of them sees, others see too.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import ClassVar

from cp_env.scenes.formats import recording
from cp_env.scenes.formats.bounded import JSON_BYTES, parse_json, read_bytes
from cp_env.types import Scene, Sweep

SPLITS = ("train", "calibration", "test")
KINDS = ("urban", "suburban", "intersection")
DATA = Path(__file__).parent / "data"
INDEX = "index.json"


class Town:
    """One split of a folder of recordings (a `SceneSource`).

    Args:
        split: "train", "calibration" or "test"; no two of them share a street.
        folder: where `python -m cp_env.scenes.sumo.record` wrote; the recordings of the package by default.

    Attributes: `family` is the name before the slash, `folder` the recordings of the package, `kinds` what the names of
    its scenes tell apart.

    Raises:
        ValueError: unknown split; the folder's index is missing or broken, or names a recording that is missing.
    """

    family: ClassVar[str] = "town"
    folder: ClassVar[Path] = DATA
    kinds: ClassVar[tuple[str, ...]] = KINDS

    def __init__(self, split: str = "train", folder: Path | None = None) -> None:
        if split not in SPLITS:
            raise ValueError(f"split must be one of {', '.join(SPLITS)}; got {split!r}")
        self.name = f"{self.family}/{split}"
        self._folder = Path(self.folder if folder is None else folder)
        self._names = _index(self._folder / INDEX, split)
        self.digest = self._digest()  # changes with any recording of the split and with the LiDAR

    def names(self) -> tuple[str, ...]:
        """The scenes of this split, in a fixed order."""
        return self._names

    def load(self, name: str) -> Scene:
        """One scene; the same object each time it is asked for.

        Raises:
            ValueError: unknown name, or a missing or broken recording.
        """
        return _load(self._path(name), name)

    def sweeps(self, scene: Scene, frames: Sequence[int]) -> list[list[Sweep]]:
        """`[frame][agent]`: the connected vehicles in order, then the road-side unit."""
        from cp_env import lidar  # heavy: imported only to cast rays

        return lidar.scan([(scene, int(frame)) for frame in frames])

    def _digest(self) -> str:
        from cp_env import lidar

        sha = hashlib.sha256(repr((self.name, lidar.DIGEST, lidar.VEHICLE, lidar.RSU)).encode())
        for name in self._names:
            sha.update(recording.content(self._path(name), name))
        return sha.hexdigest()

    def _path(self, name: str) -> Path:
        if name not in self._names:
            raise ValueError(f"unknown scene {name!r}; {self.name} holds {', '.join(self._names)}")
        return self._folder / f"{name}.npz"


class Junction(Town):
    """One split of the scenes round one junction: eight connected vehicles, and most vehicles seen by several."""

    family = "junction"
    folder = DATA / "junction"
    kinds = ("junction",)


FAMILIES: dict[str, type[Town]] = {family.family: family for family in (Town, Junction)}
"""The regimes that ship, by the name before the slash."""


@lru_cache(maxsize=256)
def _load(path: Path, name: str) -> Scene:
    scene = recording.read(path, name)
    for array in (scene.pose, scene.size, scene.connected, scene.obstacles, scene.rsu):
        if array is not None:
            array.flags.writeable = False  # it is shared by all who load it
    return scene


def _index(path: Path, split: str) -> tuple[str, ...]:
    try:
        return tuple(str(name) for name in parse_json(read_bytes(path, JSON_BYTES))[split])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ValueError(
            f"index of recordings {path} is missing or broken ({error}); reinstall or record again"
        ) from error
