"""Sizes of road vehicles: every individual differs a little from its class."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True)
class VehicleClass:
    """Mean and spread of length, width, height (m) of small to large members of one class."""

    name: str
    small: tuple[float, float, float]
    large: tuple[float, float, float]
    driving: float  # share among moving vehicles
    parked: float  # share along the kerb


CLASSES = (
    VehicleClass("city car", (3.55, 1.62, 1.45), (4.05, 1.75, 1.55), 0.22, 0.24),
    VehicleClass("car", (4.15, 1.74, 1.42), (4.75, 1.85, 1.56), 0.39, 0.42),
    VehicleClass("suv", (4.35, 1.82, 1.62), (4.95, 1.95, 1.85), 0.15, 0.14),
    VehicleClass("van", (4.80, 1.92, 1.95), (6.00, 2.05, 2.65), 0.12, 0.17),
    VehicleClass("truck", (6.80, 2.30, 3.10), (8.80, 2.50, 3.70), 0.08, 0.03),
    VehicleClass("bus", (10.5, 2.50, 2.95), (12.0, 2.55, 3.20), 0.04, 0.00),
)


def draw_sizes(n: int, rng: np.random.Generator, *, parked: bool) -> Float[np.ndarray, "n 3"]:
    """Length, width, height of `n` vehicles as they are met driving or parked; m, to the centimetre."""
    share = np.array([c.parked if parked else c.driving for c in CLASSES])
    drawn = rng.choice(len(CLASSES), size=n, p=share / share.sum())
    small, large = (np.array([getattr(c, end) for c in CLASSES])[drawn] for end in ("small", "large"))
    between = np.clip(rng.random((n, 1)) + rng.normal(0, 0.08, (n, 3)), 0, 1)  # long ones are wide and high, nearly
    return np.round(small + between * (large - small), 2)
