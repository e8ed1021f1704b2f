"""The attack whose budget grows by its rate."""

from __future__ import annotations

import numpy as np
import pytest

from agents.attacks.adaptive.ramp import Ramp
from cp_env.world.scene_cache import SceneBank
from tests.helpers.attacked_scenes import play


def test_a_ramp_grows_by_its_rate_and_no_faster(street: SceneBank) -> None:
    share = Ramp(rate=0.15, first=0.1, onset=2, ceiling=0.6)(np.arange(10))
    np.testing.assert_allclose(share, [0, 0, 0.1, 0.25, 0.4, 0.55, 0.6, 0.6, 0.6, 0.6], atol=1e-6)
    norms = np.array([o.perturbation_norm for o in play(street, "ramp", rate=0.15, first=0.1)])
    assert (np.diff(norms, axis=0) <= 0.15 * 0.3 + 1e-6).all() and (norms[-1] > norms[2]).all()
    with pytest.raises(ValueError, match="rate=0"):
        Ramp(rate=0.0)
