"""Schedules: the frames in which an attack is active."""

from __future__ import annotations

import numpy as np

from agents.attacks import schedule
from tests.agents.attacks.test_gradient import MODEL, _act
from tests.helpers import situations


def test_schedules_say_when() -> None:
    frame = np.arange(7)
    assert schedule.always(frame).all()
    assert schedule.every(3, start=1)(frame).tolist() == [False, True, False, False, True, False, False]
    assert schedule.since(5)(frame).tolist() == [False] * 5 + [True] * 2
    situation = situations.situation(MODEL, frame=np.array([2, 3]))
    for text in ("every@3", "every@2:1", "since@3"):
        assert _act("bim", situation, schedule=text).flatten(1).any(1).tolist() == [False, True]
