"""SuperSuit carries the environment to Stable-Baselines3, which learns on it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

pytest.importorskip("supersuit", reason="make library-supersuit")
pytestmark = pytest.mark.filterwarnings("default")
Run = Callable[[str], dict[str, Any]]


def test_the_page(sketched_page: Run) -> None:
    names = sketched_page("docs/supersuit.md")
    model, batch = names["model"], names["batch"]
    assert batch.num_envs == 4 and model.num_timesteps == 16
    assert all(np.isfinite(p.detach().numpy()).all() for p in model.policy.parameters())


def test_a_step_is_the_environment_s(sketched_page: Run) -> None:
    """Rows are the attackers of one world in order: what the environment itself says of the same actions."""
    import supersuit

    import cp_env
    from tests.helpers.stand_in_town import Sketch

    def make() -> Any:
        return cp_env.parallel_env("none", scenes=Sketch(), observation="compact", n_attackers=2, max_frames=4)

    wrapped, bare = supersuit.pettingzoo_env_to_vec_env_v1(make()), make()
    rows, _ = wrapped.reset(seed=3)
    told, _ = bare.reset(seed=3)
    actions = np.random.default_rng(0).uniform(-1, 1, (3, 2, 8)).astype(np.float32)
    for action in actions:
        assert np.array_equal(rows, np.stack([told[agent] for agent in bare.possible_agents]))
        rows, rewards, *_ = wrapped.step(action)
        told, paid, *_ = bare.step(dict(zip(bare.possible_agents, action, strict=True)))
        assert rewards.tolist() == pytest.approx(list(paid.values()))
    assert rewards.max() > 0
