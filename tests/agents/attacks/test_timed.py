"""Any attack on a timetable."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import agents
from agents.attacks.timed import Timed
from tests.helpers import situations
from tests.helpers.attacked_scenes import MODEL


def test_any_attacker_on_a_timetable() -> None:
    frames = [situations.situation(MODEL, frame=np.array([t, t])) for t in range(8)]

    def spoke(**timetable: Any) -> np.ndarray:
        attack = agents.make("noise", **timetable)
        assert isinstance(attack, Timed)
        attack.reset(2, np.random.default_rng(0))
        return np.array([attack.act(frame).flatten(1).any(1).tolist() for frame in frames])

    assert spoke(every=3)[:, 0].tolist() == [True, False, False] * 2 + [True, False]
    assert spoke(start=5)[:, 1].tolist() == [False] * 5 + [True] * 3
    half = spoke(duty=0.5)
    assert 0 < half.mean() < 1 and not np.array_equal(half[:, 0], half[:, 1]) and np.array_equal(half, spoke(duty=0.5))
    with pytest.raises(ValueError, match="duty"):
        agents.make("pgd", duty=0.0)
