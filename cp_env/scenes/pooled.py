"""Several sources as one: to train and to calibrate on more than one regime."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence

from cp_env.types import Scene, SceneSource, Sweep


class Pooled:
    """The scenes of several sources, one source after the other (a `SceneSource`).

    Args:
        sources: no two of them hold a scene of the same name.

    Raises:
        ValueError: no source, or a name that two of them hold.
    """

    def __init__(self, sources: Sequence[SceneSource]) -> None:
        if not sources:
            raise ValueError("a pool needs a source of scenes at least; name one")
        self.name = "+".join(source.name for source in sources)
        self.digest = hashlib.sha256(" ".join(source.digest for source in sources).encode()).hexdigest()
        self._of = {name: source for source in sources for name in source.names()}
        if len(self._of) < sum(len(source.names()) for source in sources):
            raise ValueError(f"the sources in {self.name} hold scenes of the same name; pool others")

    def names(self) -> tuple[str, ...]:
        return tuple(self._of)

    def load(self, name: str) -> Scene:
        """One scene.

        Raises:
            ValueError: no source of the pool holds it.
        """
        if name not in self._of:
            raise ValueError(f"unknown scene {name!r}; {self.name} holds {', '.join(self._of)}")
        return self._of[name].load(name)

    def sweeps(self, scene: Scene, frames: Sequence[int]) -> list[list[Sweep]]:
        """`[frame][agent]`, as the scene's own source gives them."""
        return self._of[scene.name].sweeps(scene, frames)
