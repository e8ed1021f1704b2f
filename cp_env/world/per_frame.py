"""One value a frame, computed when it is first asked for."""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, TypeVar

T = TypeVar("T")


class PerFrame(Generic[T]):
    """A sequence over the frames of a scene that computes a frame when it is first asked for.

    Args:
        n_frames: its length.
        compute: the value of a frame.
        keep: whether values stay in memory; else each reading computes anew.
    """

    def __init__(self, n_frames: int, compute: Callable[[int], T], *, keep: bool = True) -> None:
        self._n_frames, self._compute, self._keep = n_frames, compute, keep
        self._values: dict[int, T] = {}

    def __len__(self) -> int:
        return self._n_frames

    def __getitem__(self, frame: int) -> T:
        """The value of a frame; a negative one counts from the end. IndexError outside the scene."""
        if not -self._n_frames <= frame < self._n_frames:
            raise IndexError(f"frame {frame} of a scene of {self._n_frames} frames")
        frame = int(frame) % self._n_frames
        if frame in self._values:
            return self._values[frame]
        value = self._compute(frame)
        if self._keep:
            self._values[frame] = value
        return value
