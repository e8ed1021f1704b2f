"""The driving figures of a row, worked by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cp_env.evaluation import Run, summarise
from cp_env.evaluation.analysis.driving import belief_roc, driving_row
from cp_env.evaluation.plan.driving_record import DrivingRecord
from cp_env.evaluation.plan.records import PooledApMeter, Record
from tests.cp_env.evaluation.plan.test_driving_record import RECORD
from tests.helpers.toy_evaluation import record

DRIVEN = replace(RECORD, **{name: getattr(RECORD, name)[1:] for name in ("critical", "critical_missed", "decodes")})
DRIVEN = replace(DRIVEN, belief=(), **{name: getattr(RECORD, name)[1:] for name in ("removable", "removed", "spoofed")})


def believing(rows: list[list[float]]) -> DrivingRecord:
    return replace(DRIVEN, belief=tuple(np.ravel(rows).tolist()))


def episode(scene: str, driving: DrivingRecord | None, **changes: object) -> Record:
    return record(scene, "10", 2, driving=driving, **changes)


def test_without_a_recording_there_is_no_row() -> None:
    assert driving_row([episode("a", None)]) is None
    (row,) = summarise({Run("none", "pgd", 2, 0, ("a",)): [episode("a", None)]}, resamples=10)
    assert row.driving is None


def test_values_are_means_over_scenes_of_all_their_episodes() -> None:
    """Scene a: two seeds, one collides; scene b does not. Frames 2 and 3 count, 0 is grace."""
    calm = replace(DRIVEN, collided=False, mdr=4.5, min_time_to_collision=2.0)
    row = driving_row([episode("a", DRIVEN), episode("a", calm), episode("b", calm)])
    assert row is not None
    assert row.collisions is not None and row.collisions.mean == pytest.approx((0.5 + 0) / 2)
    assert row.mdr is not None and row.mdr.mean == pytest.approx(((2.5 + 4.5) / 2 + 4.5) / 2)
    assert row.mdr_hard is not None and row.mdr_hard.mean == pytest.approx((0.5 + 1) / 2)
    assert row.min_time_to_collision is not None and row.min_time_to_collision.mean == 2.0
    assert row.critical_recall is not None and row.critical_recall.mean == pytest.approx(0.0), "3 of 3 are missed"
    assert row.decodes is not None and row.decodes.mean == pytest.approx(2.0)
    assert row.late is not None and row.late.mean == pytest.approx(1 / 3)
    assert row.milliseconds == pytest.approx(1000 * 0.5 / 3)


def test_rates_of_single_episodes_have_exact_bounds() -> None:
    """One seed a scene: 1 of 9 collides, none brakes so hard. Clopper and Pearson's bounds: 0.0028, 0.4825; 0.336."""
    calm = replace(DRIVEN, collided=False, mdr=3.9)
    row = driving_row([episode("a", replace(calm, collided=True)), *(episode(name, calm) for name in "bcdefghi")])
    assert row is not None and row.collisions is not None and row.mdr_hard is not None
    assert f"{row.collisions:.2f}" == "1 of 9 [0.00, 0.48]"
    assert (row.collisions.low, row.collisions.high) == pytest.approx((0.0028, 0.4825), abs=1e-4)
    assert f"{row.mdr_hard:.3f}" == "0 of 9 [0.000, 0.336]"


def test_certified_recall_is_pooled_over_frames_and_averaged_over_scenes() -> None:
    """Frames 2 and 3 count: 1 of 4 and 3 of 4 in scene a, so 4 of 8; none of 10 in scene b."""
    half = replace(DRIVEN, vehicles=(9, 4, 4), certified=(9, 1, 3))
    row = driving_row([episode("a", half), episode("b", replace(half, vehicles=(9, 5, 5), certified=(9, 0, 0)))])
    assert row is not None and row.certified is not None and row.certified.mean == pytest.approx(0.25)
    uncounted = driving_row([episode("a", DRIVEN)])
    assert uncounted is not None and uncounted.certified is None


def test_critical_ap_is_of_its_own_meter() -> None:
    meter = PooledApMeter(np.array([0.9, 0.8]), {0.5: np.array([True, False])}, 2, 3)
    row = driving_row([episode("a", DRIVEN, critical_meter=meter)])
    assert row is not None and row.critical_ap is not None and row.critical_ap.mean == pytest.approx(0.5)
    row = driving_row([episode("a", DRIVEN)])
    assert row is not None and row.critical_ap is None


def test_the_benign_of_the_roc_are_those_of_clean_runs() -> None:
    """Attackers 1 and 3 of five; under the attack a benign one is believed in strongly, without an attack none is."""
    attacked = [episode("a", believing([[0, 0, 0, 0, 0], [0.9, 0.5, 0, 0.6, 0], [0.9, 0.5, 0, 0.6, 0]]))]
    clean = [episode("a", believing([[0.1] * 5] * 3), attackers=())]
    alone, fair = belief_roc(attacked, []), belief_roc(attacked, clean)
    assert alone is not None and fair is not None
    assert alone.auc == pytest.approx(2 / 3) and alone.tpr_at(0.03) == 0.0
    assert fair.auc == 1.0 and fair.tpr_at(0.03) == 1.0
    assert belief_roc([episode("a", replace(DRIVEN, belief=()))], clean) is None
    assert belief_roc(clean, clean) is None, "nobody is malicious"


def test_a_row_of_the_summary_has_the_clean_runs_of_its_defender() -> None:
    attacked = episode("a", believing([[0, 0, 0, 0, 0], [0.9, 0.5, 0, 0.6, 0], [0.9, 0.5, 0, 0.6, 0]]))
    clean = episode("a", believing([[0.1] * 5] * 3), attackers=())
    runs = {Run("prbi", "pgd", 2, 0, ("a",)): [attacked], Run("prbi", "none", 0, 0, ("a",)): [clean]}
    rows = {row.attack: row for row in summarise(runs, resamples=10)}
    assert rows["pgd"].driving is not None and rows["pgd"].driving.auc == 1.0
    assert rows["none"].driving is not None and rows["none"].driving.auc is None
