"""The score limit of a protocol must be exceeded: a detection of exactly that score does not count."""

from __future__ import annotations

import numpy as np
import pytest

from cp_env.metrics.average_precision import RULES, ApMeter
from cp_env.types import Detections

CAR = np.array([[0.0, 0.0, 4.0, 2.0, 0.0]])


@pytest.mark.parametrize("protocol", [name for name, rules in RULES.items() if np.isfinite(rules.above)])
def test_a_score_at_the_limit_does_not_count(protocol: str) -> None:
    limit = RULES[protocol].above
    for score, counts in ((np.nextafter(limit, 0), False), (limit, False), (np.nextafter(limit, 1), True)):
        meter = ApMeter([0.5], protocol)
        meter.add(Detections(CAR, np.array([score])), CAR)
        assert (meter.n_frames, meter.value(0.5)) == (int(counts), float(counts))
