"""Action maps that need no knowledge of the detector."""

from __future__ import annotations

import numpy as np
import torch

from cp_env.envs.actions.registry import make_action
from cp_env.world.scene_cache import SceneBank
from tests.cp_env.envs.actions.test_guided import E, K, situation


def test_full_is_the_raw_map() -> None:
    assert make_action("full", 4, 8).space.shape == (4, 8, 8)


def test_full_scales_by_the_budget(bank: SceneBank) -> None:
    actions = np.random.default_rng(0).uniform(-1, 1, (E, K, 128, 32, 32)).astype(np.float32)
    delta = make_action("full", 128, 32)(actions, situation(bank))
    np.testing.assert_allclose(delta, 0.3 * actions, rtol=1e-6)


def test_basis_directions_differ_and_zero_perturbs_nothing(bank: SceneBank) -> None:
    basis, here = make_action("basis", 128, 32), situation(bank)
    assert not basis(np.zeros((E, K, 16), np.float32), here).any()
    one, two = (basis(np.tile(np.eye(16, dtype=np.float32)[i], (E, K, 1)), here).flatten() for i in (0, 1))
    assert abs(float(torch.nn.functional.cosine_similarity(one, two, dim=0))) < 0.3
