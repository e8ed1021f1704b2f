"""The closed loop: the ego drives on what it perceives, and the others react to it.

It is the pseudo-closed loop with two differences. The ego perceives from where it stands, as the frames are made while
it drives. And the others are moved by a simulator that knows where the ego is: who drives behind it brakes with it, and
who waits for it goes when it has passed.

All else is as in `closed_loop`: the ego keeps to the path that it drives in the undisturbed traffic, the boxes of its
output are its leaders, and a collision is a rear-end one. Where it waits for signals and for those that have priority
is told by the traffic. Vehicles it must see itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from cp_env.driving.closed_loop import PseudoClosedLoop
from cp_env.driving.idm import CITY, DriverModel
from cp_env.driving.road import SLOWEST, Road
from cp_env.metrics.corridor import Path
from cp_env.types import Scene, View

BEFORE = 1.0
"""The ego stops so far before a line; m. The driver model nears a standing leader ever more slowly, and may creep."""


@runtime_checkable
class Traffic(Protocol):
    """Traffic round an ego that is driven from outside.

    `scene` is as of now: frames up to `frame` hold what has been, those after it everybody's straight continuation.
    Rows keep their vehicle. The ego is the first of the connected vehicles.
    """

    scene: Scene
    frame: int
    path: Path  # of the ego's centre, from its first place on
    fastest: float  # of the ego in the undisturbed traffic; m/s
    ended: bool  # nothing more can be driven

    def stop_lines(self) -> list[float]:
        """From the ego's front bumper to the lines at which it has to wait now, of those ahead; m."""
        ...

    def step(self, place: Float[np.ndarray, " 3"], speed: float) -> None:
        """Move the ego there (x, y, yaw of its box; m, rad) at that speed (m/s), and all others to the next frame."""
        ...


class ClosedLoop(PseudoClosedLoop):
    """One drive in traffic that reacts to it.

    Args:
        traffic: at the first frame of the drive.
        driver: of the ego.
    """

    def __init__(self, traffic: Traffic, driver: DriverModel = CITY) -> None:
        super().__init__([traffic.scene], [traffic.frame], driver)
        self.traffic = traffic
        self._struck, self._crossed = set[int](), set[int]()
        scene, ego = traffic.scene, int(traffic.scene.connected[0])
        desired = max(SLOWEST, traffic.fastest)
        self._roads = [Road(scene, traffic.frame, traffic.path, ego, desired, [], np.zeros((0, 2)))]

    def step(self, outputs: Sequence[View]) -> None:
        """Drive on until the next frame, behind the output of this one; a drive that has ended stays where it is."""
        if self.traffic.ended:
            self._running[0] = False
        super().step(outputs)

    @property
    def over(self) -> bool:
        """Whether the drive has ended: in a collision, with the last frame, or with the traffic."""
        return not self._running[0] or bool(self._collided[0]) or self.traffic.ended

    @property
    def struck(self) -> int:
        """How many vehicles have driven into the ego from behind. It is no collision of the ego's."""
        return len(self._struck)

    @property
    def crossed(self) -> int:
        """How many crossing or oncoming vehicles it has touched. They are no collision either."""
        return len(self._crossed)

    def _check_collision(self, e: int) -> None:
        touched = self._contacts(e)
        self._struck |= set(touched.rows[~touched.ahead & touched.same_way & ~touched.appeared].tolist())
        self._crossed |= set(touched.rows[~touched.same_way & ~touched.appeared].tolist())
        super()._check_collision(e)

    def _move_others(self) -> None:
        if self._running[0]:
            self.traffic.step(self.place(0), float(self.speed[0]))
            self._roads[0].scene = self.traffic.scene

    def _stops(self, road: Road, along: float) -> list[float]:
        return [gap + self.driver.standstill - BEFORE for gap in self.traffic.stop_lines()]
