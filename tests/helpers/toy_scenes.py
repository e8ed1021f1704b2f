"""Two small crossings built by hand, for tests that need traffic but no recording.

```
             N
    bldg  | ↓ ↑ |  bldg        streets 8 m wide cross at the origin; buildings stand at the four corners,
  --------+     +--------      parked cars line the east-west street, a van and a truck stand among them,
   ←  ego            P P       the connected vehicles drive on both streets; the road-side unit hangs over
   →   P P              →      the north-east kerb.
  --------+     +--------
    bldg  | ↓ ↑ |  bldg
```
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cp_env import lidar
from cp_env.types import Scene, Sweep

CAR, VAN, TRUCK = (4.5, 1.8, 1.5), (5.5, 2.0, 2.3), (8.5, 2.5, 3.4)
EAST, NORTH, WEST, SOUTH = 0.0, np.pi / 2, np.pi, -np.pi / 2
# x, y (m at frame 0), heading (rad), speed (m/s), size
DRIVING = (
    (-14.0, -2.0, EAST, 5.0, CAR),
    (-24.0, -2.0, EAST, 5.0, CAR),
    (15.0, 2.0, WEST, 4.0, CAR),
    (2.0, -16.0, NORTH, 3.0, CAR),
    (-2.0, 18.0, SOUTH, 4.0, VAN),
    (27.0, 2.0, WEST, 4.0, CAR),
    (2.0, -26.0, NORTH, 3.0, CAR),
    (-2.0, 28.0, SOUTH, 4.0, CAR),
)
PARKED = (
    (12.0, -5.0, EAST, 0.0, CAR),
    (18.5, -5.0, EAST, 0.0, TRUCK),
    (25.0, -5.0, EAST, 0.0, CAR),
    (-11.0, 5.0, WEST, 0.0, CAR),
    (-17.5, 5.0, WEST, 0.0, VAN),
    (-23.5, 5.0, WEST, 0.0, CAR),
)
BUILDINGS = tuple((sx * 20.0, sy * 16.0, 0.0, 24.0, 16.0, 9.0) for sx in (-1, 1) for sy in (-1, 1))


def toy_scene(
    *, name: str = "toy-0", n_frames: int = 12, n_connected: int = 5, rsu: bool = True, yaw: float = 0.0
) -> Scene:
    """A crossing with `n_connected` (1 to 8) connected vehicles, turned by `yaw` about the origin.

    The connected vehicles are rows 0, 1, …; driving vehicles without a radio and parked ones follow.
    """
    assert 1 <= n_connected <= len(DRIVING)
    states = np.array([row[:4] for row in DRIVING + PARKED])
    seconds = 0.2 * np.arange(n_frames)[:, None]
    x = states[:, 0] + seconds * states[:, 3] * np.cos(states[:, 2])
    y = states[:, 1] + seconds * states[:, 3] * np.sin(states[:, 2])
    c, s = np.cos(yaw), np.sin(yaw)
    heading = np.broadcast_to(states[:, 2] + yaw, x.shape)
    walls = np.array(BUILDINGS)
    walls[:, :2] = walls[:, :2] @ np.array([[c, s], [-s, c]])
    walls[:, 2] += yaw
    return Scene(
        name=name,
        kind="intersection",
        dt=0.2,
        pose=np.stack([c * x - s * y, s * x + c * y, heading], axis=-1),
        size=np.array([row[4] for row in DRIVING + PARKED]),
        connected=np.arange(n_connected),
        rsu=np.array([c * 5 - s * 5, s * 5 + c * 5, 6.0]) if rsu else None,
        obstacles=walls,
    )


class ToySource:
    """Two toy crossings, the second turned by 0.4 rad, as a `SceneSource`."""

    def __init__(self, *, n_frames: int = 12, n_connected: int = 5, rsu: bool = True) -> None:
        self.name = "toy"
        self.digest = f"toy-{n_frames}-{n_connected}-{rsu}-{lidar.DIGEST}"
        self._scenes = {
            name: toy_scene(name=name, n_frames=n_frames, n_connected=n_connected, rsu=rsu, yaw=yaw)
            for name, yaw in (("toy-0", 0.0), ("toy-1", 0.4))
        }

    def names(self) -> tuple[str, ...]:
        return tuple(self._scenes)

    def load(self, name: str) -> Scene:
        return self._scenes[name]

    def sweeps(self, scene: Scene, frames: Sequence[int]) -> list[list[Sweep]]:
        return lidar.scan([(scene, frame) for frame in frames])
