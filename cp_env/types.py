"""Frozen data that flows down the river: scene → sweep → detections.

Convention:
    world frame   x east, y north, z up; metres; ground at z = 0; yaw in radians, counter-clockwise from east.
    grid frame    a vehicle's own frame: its origin is the point of a world-wide lattice next to its sensor
                  (`geometry.grid_origin`), its axes are the world's (a compass is assumed), so two grid frames differ
                  by a translation of whole cells only; z is height above ground.
    box           (x, y, length, width, yaw): centre, full extents along and across the heading, heading.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeVar, runtime_checkable

import numpy as np
from jaxtyping import Float, Int

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Scene:
    """One recorded episode of traffic, in the world frame.

    A vehicle that is absent in a frame has NaN in `pose` there. Parked cars are vehicles like any other.
    """

    name: str
    kind: str  # "urban" | "suburban" | "intersection"
    dt: float  # seconds between frames
    pose: Float[np.ndarray, "T M 3"]  # x, y, yaw of the box centre; m, m, rad
    size: Float[np.ndarray, "M 3"]  # length, width, height; m
    connected: Int[np.ndarray, " A"]  # rows of those with a radio, present in every frame; the first is the ego
    rsu: Float[np.ndarray, " 3"] | None  # x, y, z of the road-side unit's sensor
    obstacles: Float[np.ndarray, "B 6"]  # x, y, yaw, length, width, height; buildings, walls, trunks on the ground

    @property
    def n_frames(self) -> int:
        return len(self.pose)

    @property
    def n_connected(self) -> int:
        return len(self.connected)


@dataclass(frozen=True, eq=False)
class Sweep:
    """One LiDAR revolution of one sensor."""

    points: Float[np.ndarray, "P 3"]  # x, y from the sensor along the world's axes, z above ground; m
    origin: Float[np.ndarray, " 3"]  # x, y, z of the sensor in the world frame; m
    hits: Int[np.ndarray, " M"] | None = None  # returns from each of the scene's vehicles, where the source knows


@dataclass(frozen=True, eq=False)
class Detections:
    """Oriented boxes, best score first, in the grid frame of the ego that detected them."""

    boxes: Float[np.ndarray, "L 5"]
    scores: Float[np.ndarray, " L"]

    def above(self, threshold: float) -> Detections:
        """Only the boxes whose score is at least `threshold`."""
        keep = self.scores >= threshold
        return Detections(self.boxes[keep], self.scores[keep])


def frozen(array: np.ndarray) -> np.ndarray:
    """A copy that cannot be written, nor made writable: it lies over immutable bytes."""
    if array.size == 0:
        empty = np.zeros(array.shape, array.dtype)
        empty.flags.writeable = False
        return empty
    return np.frombuffer(array.tobytes(), dtype=array.dtype).reshape(array.shape)


def _like(thing: T, **other: Any) -> T:
    """A shallow copy with other fields: `copy.copy` takes many times as long, and a frame has dozens."""
    twin = object.__new__(type(thing))
    twin.__dict__.update(thing.__dict__, **other)
    return twin


@dataclass(frozen=True, eq=False)
class View:
    """The ego's output when it fuses one group of maps. Opaque to defenders: they hold it and compare it."""

    group: frozenset[int]
    frame: int
    origin: Float[np.ndarray, " 2"]  # the ego's grid origin in the world frame; m
    detections: Detections  # every box down to the decoder's floor, for AP
    seen: Detections = field(repr=False)  # those at or above the operating threshold: what the ego acts on
    score_map: Float[np.ndarray, "h w"] = field(repr=False)  # per-cell probability of a vehicle centre

    def __post_init__(self) -> None:
        """Views are handed to plug-ins and kept from frame to frame: their arrays are read-only copies."""
        for name in ("origin", "score_map"):
            object.__setattr__(self, name, frozen(getattr(self, name)))
        for name in ("detections", "seen"):
            found: Detections = getattr(self, name)
            object.__setattr__(self, name, Detections(frozen(found.boxes), frozen(found.scores)))

    def __deepcopy__(self, memo: dict[int, Any]) -> View:
        """Itself: a view never changes, so copies of whoever holds it may share it."""
        return self

    def twin(self) -> View:
        """Another object over the same read-only arrays: whoever sets its fields by force leaves this one alone."""
        return _like(self, detections=_like(self.detections), seen=_like(self.seen))


@runtime_checkable
class SceneSource(Protocol):
    """Where scenes come from. All sources give the same types and pass the same laws."""

    name: str
    digest: str  # changes whenever the sweeps would; part of the cache key

    def names(self) -> tuple[str, ...]:
        """The scenes of this source's split."""
        ...

    def load(self, name: str) -> Scene: ...

    def sweeps(self, scene: Scene, frames: Sequence[int]) -> list[list[Sweep]]:
        """`[frame][agent]`: the connected vehicles in order, then the road-side unit if the scene has one."""
        ...


@runtime_checkable
class Endless(Protocol):
    """A source whose scenes hardly come back: nothing of them is kept longer than it is needed."""

    endless: bool
