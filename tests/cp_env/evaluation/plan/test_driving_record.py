"""What a record holds of the driving: shares worked by hand, and what is no such record."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cp_env.evaluation.plan.driving_record import DrivingRecord, believed

RECORD = DrivingRecord(
    critical=(2, 2, 0, 3),
    critical_missed=(2, 1, 0, 3),
    removable=(1, 1, 1, 0),
    removed=(0, 1, 0, 0),
    spoofed=(0, 0, 1, 1),
    decodes=(1, 3, 3, 1),
    belief=(0.5, 0.0, 1.0, 0.25, 0.0, 0.0, 0.5, 0.5),
    late_frames=1,
    mdr=2.5,
    fsr=0.0,
    collided=True,
    hard_brakings=2,
    hardest_braking=9.0,
    impact_speed=3.5,
    min_time_to_collision=None,
    mean_speed=4.0,
)


def test_shares_leave_the_grace_frames_out() -> None:
    """With one frame of grace: 4 of 5 critical vehicles missed, 1 of 2 targets removed, 2 of 3 frames spoofed."""
    assert RECORD.recall(1) == pytest.approx(1 / 5)
    assert RECORD.recall(0) == pytest.approx(1 / 7)
    assert RECORD.removal(1) == 0.5
    assert RECORD.spoofing(1) == pytest.approx(2 / 3)
    assert RECORD.streak(1) == 3, "one frame of removal and then two of spoofing"
    assert RECORD.beliefs(2).tolist() == [[0.5, 0.0], [1.0, 0.25], [0.0, 0.0], [0.5, 0.5]]


def test_certified_recall_leaves_the_grace_frames_out() -> None:
    """Of 5 + 4 + 1 vehicles after one frame of grace 2 + 1 + 0 are certified."""
    counted = replace(RECORD, vehicles=(6, 5, 4, 1), certified=(6, 2, 1, 0))
    assert counted.certified_recall(1) == pytest.approx(0.3)
    assert RECORD.certified_recall(0) is None and replace(counted, vehicles=(0,) * 4).certified_recall(0) is None


def test_a_record_of_before_has_no_witnesses() -> None:
    stored = {name: value for name, value in RECORD.to_json().items() if name not in ("vehicles", "certified")}
    assert DrivingRecord.from_json(json.loads(json.dumps(stored)), 4, 2).vehicles == ()


def test_what_cannot_be_told_is_none() -> None:
    nothing = replace(RECORD, critical=(0,) * 4, critical_missed=(0,) * 4, removable=(0,) * 4, removed=(0,) * 4)
    assert nothing.recall(1) is None and nothing.removal(1) is None
    assert RECORD.spoofing(4) is None
    assert replace(RECORD, belief=()).beliefs(2).shape == (0, 2)


def test_it_survives_being_written_down() -> None:
    stored = json.loads(json.dumps(RECORD.to_json()))
    assert DrivingRecord.from_json(stored, 4, 2).to_json() == RECORD.to_json()


@pytest.mark.parametrize(
    "change",
    [
        {"critical": [1, 2]},
        {"critical": [1.0, 2, 0, 3]},
        {"belief": [0.5]},
        {"belief": [1, 0, 0, 0, 0, 0, 0, 0]},
        {"mdr": "2"},
        {"collided": 1},
        {"late_frames": True},
        {"more": 1},
        {"min_time_to_collision": 3},
        {"removable": [2, 1, 1, 1]},
        {"removable": [0, 0, 0, 0], "removed": [0, 0, 1, 0]},
        {"critical": [0, 0, 0, 0], "critical_missed": [0, 0, 0, 1]},
        {"critical": [10**400, 0, 0, 0], "critical_missed": [0, 0, 0, 0]},
        {"spoofed": [0, 0, 0, -1]},
        {"decodes": [1, 1, 1, -1]},
        {"belief": [0.5, 0.0, 1.0, 0.25, 0.0, 0.0, 0.5, 1.5]},
        {"belief": [0.5, 0.0, 1.0, 0.25, 0.0, 0.0, 0.5, float("nan")]},
        {"late_frames": -1},
        {"mdr": float("inf")},
        {"fsr": -0.5},
        {"impact_speed": float("nan")},
        {"mean_speed": -1.0},
        {"min_time_to_collision": float("inf")},
        {"vehicles": [5, 5, 5, 5]},
        {"vehicles": [5, 5], "certified": [1, 1]},
        {"vehicles": [5, 5, 5, 5], "certified": [1, 1, 6, 1]},
        {"vehicles": [5, 5, 5, 5], "certified": [1, 1, -1, 1]},
    ],
)
def test_values_that_are_none_of_such_a_record(change: dict[str, Any]) -> None:
    with pytest.raises((ValueError, TypeError)):
        DrivingRecord.from_json(json.loads(json.dumps(RECORD.to_json())) | change, 4, 2)


@pytest.mark.parametrize("belief", [[], [0.5], [np.nan, 0.5], ["a", "b"], None, [[0.1, 0.2, 0.3]]])
def test_what_is_no_belief_is_not_recorded(belief: Any) -> None:
    assert list(believed(belief, 2)) == []


def test_a_belief_is_cut_to_probabilities() -> None:
    assert list(believed(np.array([-0.5, 1.5]), 2)) == [0.0, 1.0]
