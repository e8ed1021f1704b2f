"""Sizes of driving and parked vehicles."""

from __future__ import annotations

import numpy as np
import pytest

from cp_env.scenes.sumo.vehicle_sizes import CLASSES, draw_sizes


@pytest.mark.parametrize("parked", [True, False])
def test_drawn_sizes_belong_to_a_class(parked: bool) -> None:
    sizes = draw_sizes(2000, np.random.default_rng(0), parked=parked)
    inside = [((sizes >= np.array(c.small) - 1e-9) & (sizes <= np.array(c.large) + 1e-9)).all(axis=1) for c in CLASSES]
    assert np.any(inside, axis=0).all()
    assert abs((sizes[:, 0] > 6.5).mean() - sum(c.parked if parked else c.driving for c in CLASSES[4:])) < 0.03
