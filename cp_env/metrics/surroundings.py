"""The traffic round the ego in one frame, as the referee knows it: true boxes, velocities and the ego's corridor."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from cp_env.geometry.planar import grid_origin
from cp_env.metrics.corridor import Corridor
from cp_env.metrics.ground_truth import rows_in_range, truth_boxes
from cp_env.metrics.kinematics import required_deceleration, time_to_collision, velocities
from cp_env.types import Scene, frozen

NEAR = 10.0
"""A vehicle in the corridor with a smaller gap than this is critical; m."""

SOON = 4.0
"""A vehicle with less time to collision than this is critical; s."""


@dataclass(frozen=True, eq=False)
class Surroundings:
    """The vehicles in the ego's range, in its grid frame."""

    boxes: Float[np.ndarray, "L 5"]  # m, rad
    velocity: Float[np.ndarray, "L 2"]  # along the world's axes; m/s
    vehicle: Int[np.ndarray, " L"]  # rows of the scene; -1 for what is no vehicle of it
    ego_box: Float[np.ndarray, " 5"]
    ego_velocity: Float[np.ndarray, " 2"]  # m/s
    corridor: Corridor
    origin: Float[np.ndarray, " 2"]  # of the grid frame in the world; m
    dt: float  # seconds between frames

    def __post_init__(self) -> None:
        """Rewards and other plug-ins see these arrays: they are read-only copies."""
        for one in fields(self):
            value = getattr(self, one.name)
            if isinstance(value, np.ndarray):
                object.__setattr__(self, one.name, frozen(value))
        object.__setattr__(self, "corridor", Corridor(frozen(self.corridor.points), self.corridor.front))

    @classmethod
    def of(cls, scene: Scene, frame: int, ego: int, extent: float) -> Surroundings:
        """Those of the vehicle in row `ego`; rows as in `ground_truth.truth_boxes`, strict.

        Args:
            scene: the scene.
            frame: number of the frame.
            ego: the ego's row.
            extent: reach of the map to each side; m.
        """
        pose, rows = scene.pose[frame, ego], rows_in_range(scene, frame, ego, extent)
        origin, moving = grid_origin(pose[:2]), velocities(scene, frame)
        speed = float(np.linalg.norm(moving[ego]))
        return cls(
            boxes=truth_boxes(scene, frame, ego, extent).astype(np.float64),
            velocity=moving[rows],
            vehicle=rows,
            ego_box=np.array([*(pose[:2] - origin), *scene.size[ego, :2], pose[2]], dtype=np.float64),
            ego_velocity=moving[ego],
            corridor=Corridor.recorded(scene, frame, ego, origin, speed),
            origin=origin,
            dt=scene.dt,
        )

    def standing(self, boxes: Float[np.ndarray, "G 5"]) -> Surroundings:
        """The same with these boxes in the place of the vehicles, none of which moves.

        It says what a box of the output demands that is no true vehicle: an output tells no velocities, so it is taken
        to stand, our choice.
        """
        twin = object.__new__(Surroundings)  # whose other arrays are read-only copies already
        twin.__dict__.update(
            boxes=frozen(np.asarray(boxes, dtype=np.float64)),
            velocity=frozen(np.zeros((len(boxes), 2))),
            vehicle=frozen(np.full(len(boxes), -1)),
            **{name: self.__dict__[name] for name in ("ego_box", "ego_velocity", "corridor", "origin", "dt")},
        )
        return twin

    @cached_property
    def _on_path(self) -> tuple[Float[np.ndarray, " L"], Float[np.ndarray, "L 2"]]:
        gap, direction = self.corridor.gaps(self.boxes)
        return frozen(gap), frozen(direction)

    @property
    def gap(self) -> Float[np.ndarray, " L"]:
        """From the ego's front bumper along the corridor; m, infinite outside of it."""
        return self._on_path[0]

    @cached_property
    def closing(self) -> Float[np.ndarray, " L"]:
        """Speed at which the gap shrinks: the ego's less the vehicle's along the path; m/s."""
        ego = float(np.linalg.norm(self.ego_velocity))
        return frozen(ego - (self.velocity * self._on_path[1]).sum(axis=1))

    @cached_property
    def time_to_collision(self) -> Float[np.ndarray, " L"]:
        """See `kinematics.time_to_collision`; s."""
        return frozen(time_to_collision(self.boxes, self.velocity, self.ego_box, self.ego_velocity))

    @cached_property
    def critical(self) -> Bool[np.ndarray, " L"]:
        """Whether a vehicle is critical: within 10 m in the ego's corridor, or with a time to collision below 4 s."""
        return frozen((self.gap < NEAR) | (self.time_to_collision < SOON))

    @cached_property
    def any_critical(self) -> bool:
        """Whether one of them is critical; times to collision are computed only where no gap says so."""
        return bool((self.gap < NEAR).any()) or bool((self.time_to_collision < SOON).any())

    @cached_property
    def deceleration(self) -> Float[np.ndarray, " L"]:
        """What each vehicle demands of the ego; m/s², 0 outside of the corridor."""
        return frozen(np.where(np.isfinite(self.gap), required_deceleration(self.closing, self.gap), 0.0))

    @cached_property
    def nearest(self) -> int | None:
        """Row of the nearest vehicle in the corridor, or, if that is empty, of the nearest at all; None if none is."""
        if not len(self.boxes):
            return None
        if np.isfinite(self.gap).any():
            return int(self.gap.argmin())
        return int(np.linalg.norm(self.boxes[:, :2] - self.ego_box[:2], axis=1).argmin())

    @cached_property
    def targets(self) -> Int[np.ndarray, " W"]:
        """Rows of the critical vehicles and of the nearest one, ascending: those that an output is asked about."""
        chosen = self.critical.copy()
        if self.nearest is not None:
            chosen[self.nearest] = True
        return frozen(np.flatnonzero(chosen))

    @cached_property
    def target_boxes(self) -> Float[np.ndarray, "W 5"]:
        """Their boxes."""
        return frozen(self.boxes[self.targets])


@lru_cache(maxsize=4096)
def surroundings(scene: Scene, frame: int, extent: float) -> Surroundings:
    """Those of the scene's ego. No attack changes them, so they are remembered."""
    return Surroundings.of(scene, frame, int(scene.connected[0]), extent)


@lru_cache(maxsize=64)
def frozen_scene(scene: Scene) -> Scene:
    """The same scene over read-only arrays; the same object each time."""
    parts: dict[str, Any] = {one.name: getattr(scene, one.name) for one in fields(scene)}
    arrays: dict[str, Any] = {name: frozen(part) for name, part in parts.items() if isinstance(part, np.ndarray)}
    return replace(scene, **arrays)
