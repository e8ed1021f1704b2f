"""RLlib trains PPO on the environment, which it takes as it is."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

pytest.importorskip("ray", reason="make library-rllib")
pytest.importorskip("ray.rllib", reason="make library-rllib")
pytestmark = pytest.mark.filterwarnings("default")
Run = Callable[[str], dict[str, Any]]


@pytest.fixture(scope="module")
def node() -> Iterator[None]:
    """Ray's node. It has 30 s to come up, whatever one sets: on a crowded machine it is tried again, twice."""
    import ray

    for left in (2, 1, 0):
        try:
            ray.init(num_cpus=1, include_dashboard=False, log_to_driver=False)
            break
        except Exception:  # Ray raises nothing more special
            ray.shutdown()
            if not left:
                raise
    yield
    ray.shutdown()


@pytest.mark.usefixtures("node")
def test_the_page(sketched_page: Run) -> None:
    """One iteration: frames are sampled and the attackers' shared policy moves."""
    names = sketched_page("docs/rllib.md")
    result = names["result"]
    assert result["env_runners"]["num_env_steps_sampled_lifetime"] >= 12
    learnt = result["learners"]["attacker"]
    assert np.isfinite(learnt["total_loss"]) and learnt["num_module_steps_trained"] > 0
    assert result["env_runners"]["num_module_steps_sampled"]["attacker"] >= 24, "two attackers a frame"


def test_the_wrapper_s_frames_are_the_environment_s() -> None:
    """The same seed and actions give the same numbers; each frame's dicts are new ones."""
    from ray.rllib.env.wrappers.pettingzoo_env import ParallelPettingZooEnv

    import cp_env
    from tests.helpers.stand_in_town import Sketch

    def make() -> Any:
        return cp_env.parallel_env("none", scenes=Sketch(), observation="compact", max_frames=4)

    wrapped, bare = ParallelPettingZooEnv(make()), make()
    assert set(wrapped.get_agent_ids() if hasattr(wrapped, "get_agent_ids") else wrapped.agents) <= set(
        bare.possible_agents
    )
    seen, _ = wrapped.reset(seed=5)
    told, _ = bare.reset(seed=5)
    over = False
    while not over:
        actions = {agent: np.full(8, 0.9, np.float32) for agent in bare.agents}
        before = seen
        seen, rewards, _, truncated, infos = wrapped.step(actions)
        told, paid, _, _, numbers = bare.step(actions)
        assert all(np.array_equal(seen[agent], told[agent]) for agent in told)
        assert rewards == paid and infos == numbers and seen is not before
        over = truncated["__all__"]
    assert max(paid.values()) > 0
