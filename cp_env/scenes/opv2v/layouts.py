"""What differs between data sets that are kept in OPV2V's folders."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Layout:
    """How to understand the files of one family."""

    kind: str  # by which a source is named
    title: str  # of the data
    right_handed: bool  # axes of the world, of sensors and of vehicles; else CARLA's
    local_boxes: bool  # given in the LiDAR frame of the agent that lists them, and numbered by it; else in the world
    agents_are_vehicles: bool  # an agent's folder is named by its vehicle's number; else its box is found by place
    on_ground: bool  # a vehicle's origin lies on the ground; else the bottom of its box does
    tick: float  # s that one file number stands for
    counts: tuple[float, ...]  # s that it may stand for where files are numbered one by one


OPV2V = Layout("opv2v", "OPV2V", False, False, True, True, 0.05, (0.05, 0.1))
"""CARLA at 20 Hz, of which OPV2V and V2XSet keep every second frame. Numbered one by one, files may be 20 or 10 Hz."""

V2V4REAL = Layout("v2v4real", "V2V4Real", True, True, False, False, 0.1, (0.1,))
V2X_REAL = Layout("v2x-real", "V2X-Real", True, False, False, False, 0.1, (0.1,))
