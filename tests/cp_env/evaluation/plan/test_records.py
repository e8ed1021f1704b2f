"""Records on disk."""

from __future__ import annotations

import json

import pytest

from cp_env.evaluation import Record
from tests.helpers.toy_evaluation import record


@pytest.mark.parametrize("hits", ["", "0", "1", "1101", "0101010111"])
def test_records_survive_being_written_down(hits: str) -> None:
    original = record("a", hits, 8, error="why", converged=2)
    copy = Record.from_json(json.loads(json.dumps(original.to_json())))
    assert copy.to_json() == original.to_json()
    for iou in (0.5, 0.7):
        assert copy.meter.value(iou) == pytest.approx(original.meter.value(iou), abs=1e-12)
        assert (copy.meter.matched(iou)[1] == original.meter.matched(iou)[1]).all()
    both = copy.meter.merge(original.meter)
    assert both.n_truth == 16
    assert both.value(0.5) == pytest.approx(original.meter.value(0.5))
