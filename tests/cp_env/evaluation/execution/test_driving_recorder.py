"""The driving of a played run against the outcomes it was made of."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import agents
import defenders
from cp_env.evaluation import Rollout, Run, play
from cp_env.evaluation.execution import driving_recorder
from cp_env.evaluation.plan.records import Record
from cp_env.metrics.severity import SeverityMeter
from defenders.baselines import NoDefence
from tests.helpers.toy_evaluation import CONDITIONS, toy_bank


def rollout(defender: str) -> Rollout:
    run = Run(defender, "pgd:steps=2", 2, 7, CONDITIONS.names)
    return Rollout(run, CONDITIONS, toy_bank(), agents.make("pgd:steps=2"))


def test_a_record_holds_what_the_outcomes_say() -> None:
    run = Run("prbi", "pgd:steps=2", 2, 7, CONDITIONS.names)
    records = play(run, CONDITIONS, toy_bank(), agents.make("pgd:steps=2"))
    again = rollout("prbi")
    meters = [SeverityMeter() for _ in records]
    for t in range(CONDITIONS.frames):
        outcome = again.step()
        for e, record in enumerate(records):
            driving = record.driving
            assert driving is not None
            found, there = outcome.critical[e]
            assert (driving.critical[t], driving.critical_missed[t]) == (there, there - found)
            assert driving.removed[t] == outcome.removed[e] <= outcome.removable[e] == driving.removable[t]
            assert driving.spoofed[t] == outcome.spoofed[e]
            assert driving.vehicles[t] == len(outcome.truth[e]) >= driving.certified[t]
            assert driving.decodes[t] == outcome.decodes[e] > outcome.verifications[e] - 1
            meters[e].add(outcome.output[e].seen.boxes, outcome.surroundings[e])
    for record, meter in zip(records, meters, strict=True):
        assert record.driving is not None and record.critical_meter is not None
        assert record.driving.mdr == pytest.approx(meter.mdr, abs=1e-6)
        assert record.driving.fsr == pytest.approx(meter.fsr, abs=1e-6)
        assert record.critical_meter.n_truth == sum(record.driving.critical)
        assert len(record.driving.belief) == CONDITIONS.frames * record.n_maps
        assert Record.from_json(record.to_json()).to_json() == record.to_json()


def test_vehicles_with_enough_witnesses_are_certified() -> None:
    """Two attackers: five witnesses are needed. They are no part of an outcome, so without them nothing is counted."""
    outcome = rollout("none").step()
    recorder = driving_recorder.DrivingRecorder(5)
    recorder.add(outcome, 0, NoDefence(), np.array([5, 4, 0, 5]))
    assert (recorder.record().vehicles, recorder.record().certified) == ((4,), (2,))
    uncounted = driving_recorder.DrivingRecorder(5)
    uncounted.add(outcome, 0, NoDefence())
    assert uncounted.record().vehicles == uncounted.record().certified == ()


class Silent(NoDefence):
    """A defender without a belief."""

    def belief(self) -> np.ndarray:
        return np.zeros(0)


class Broken(NoDefence):
    """A defender that fails when it is asked what it believes."""

    def belief(self) -> Any:
        raise RuntimeError("no")


@pytest.mark.parametrize("defender", [Silent, Broken])
def test_a_defender_without_a_belief_has_none_recorded(defender: type[defenders.Defender]) -> None:
    outcome = rollout("none").step()
    recorder = driving_recorder.DrivingRecorder(5)
    recorder.add(outcome, 0, defender())
    assert recorder.record().belief == ()


def test_frames_past_the_deadline_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    outcome = rollout("none").step()
    for deadline, late in ((outcome.seconds, 0), (outcome.seconds / 3, 1)):  # two worlds share the time
        monkeypatch.setattr(driving_recorder, "DEADLINE", deadline)
        recorder = driving_recorder.DrivingRecorder(5)
        recorder.add(outcome, 0, NoDefence())
        assert recorder.record().late_frames == late
