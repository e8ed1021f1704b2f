"""The Intelligent Driver Model: how hard a driver accelerates behind a leader.

Treiber, Hennecke and Helbing, "Congested traffic states in empirical observations and microscopic simulations",
Phys. Rev. E 62 (2000) 1805; the parameters are those for city traffic of Treiber and Kesting, "Traffic Flow Dynamics"
(2013), Table 11.2, but for the desired speed, which is given with each call.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

CLOSEST = 0.1
"""Least gap in the model, which divides by it; m."""


@dataclass(frozen=True, kw_only=True)
class DriverModel:
    """The parameters of a driver.

    Raises:
        ValueError: a parameter that is not positive.
    """

    headway: float = 1.0  # T, time to the leader; s
    standstill: float = 2.0  # s0, gap to a standing leader; m
    acceleration: float = 1.0  # a; m/s²
    deceleration: float = 1.5  # b, comfortable; m/s²
    exponent: float = 4.0  # δ
    hardest: float = 9.0  # braking that no car exceeds; m/s². Not of the model, which knows no limit.

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not value > 0:
                raise ValueError(f"{name} of a driver must be positive, not {value}")

    def __call__(
        self,
        speed: Float[np.ndarray, "*n"],
        desired: Float[np.ndarray, "*n"],
        gap: Float[np.ndarray, "*n"],
        closing: Float[np.ndarray, "*n"],
    ) -> Float[np.ndarray, "*n"]:
        """dv/dt = a (1 − (v/v0)^δ − (s*/s)²) with s* = s0 + max(0, v T + v Δv / (2 √(a b))); m/s².

        Args:
            speed: v of the ego; m/s.
            desired: v0, its speed on a free road; m/s.
            gap: s, from bumper to bumper; m. Infinite without a leader.
            closing: Δv, speed at which the gap shrinks; m/s.

        Returns:
            The acceleration, at least −`hardest`. Above the desired speed it is at least −b on a free road: our choice,
            as the model brakes without a bound where the desired speed falls.
        """
        brake = 2 * np.sqrt(self.acceleration * self.deceleration)
        wanted = self.standstill + np.maximum(speed * self.headway + speed * closing / brake, 0.0)
        free = self.acceleration * (1 - (speed / np.maximum(desired, CLOSEST)) ** self.exponent)
        bound = np.maximum(free, -self.deceleration) - self.acceleration * (wanted / np.maximum(gap, CLOSEST)) ** 2
        return np.clip(bound, -self.hardest, self.acceleration)


CITY = DriverModel()
"""City traffic."""
