"""A subset of a scene source: encoding a scene costs seconds, and a small learner needs only a few of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cp_env.scenes import open_source
from cp_env.types import Scene, SceneSource, Sweep


class SceneSubset:
    """`n` scenes of a source, spread evenly over its list. Encoded maps are shared with the whole source's.

    Args:
        source: a scene source, or its name.
        n: number of scenes; all by default.

    Raises:
        ValueError: more scenes than the source holds, or none.
    """

    def __init__(self, source: str | SceneSource, n: int | None = None) -> None:
        self._source = open_source(source)
        self.name, self.digest = self._source.name, self._source.digest
        names = self._source.names()
        n = len(names) if n is None else n
        if not 1 <= n <= len(names):
            raise ValueError(f"{self.name} holds {len(names)} scenes: ask for 1 to {len(names)} of them, not {n}")
        self._names = tuple(names[i] for i in np.linspace(0, len(names) - 1, n).astype(int))

    def names(self) -> tuple[str, ...]:
        return self._names

    def load(self, name: str) -> Scene:
        return self._source.load(name)

    def sweeps(self, scene: Scene, frames: Sequence[int]) -> list[list[Sweep]]:
        return self._source.sweeps(scene, frames)
