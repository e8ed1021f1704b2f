"""TorchRL's own check of specs passes, and a rollout holds what the environment says."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

pytest.importorskip("torchrl", reason="make library-torchrl")
pytestmark = pytest.mark.filterwarnings("default")
Run = Callable[[str], dict[str, Any]]


def test_the_page(sketched_page: Run) -> None:
    names = sketched_page("docs/torchrl.md")
    rollout = names["rollout"]
    assert rollout["adversary", "observation"].shape == (6, 2, 25)
    assert rollout["next", "adversary", "reward"].shape == (6, 2, 1)
    assert bool(rollout["next", "truncated"][-1])


@pytest.mark.parametrize("options", [{"observation": "features"}, {"slots": "vehicles", "observation": "compact"}])
def test_specs(options: dict[str, Any]) -> None:
    """Dict observations and vehicles as agents too; with the state for centralised critics."""
    from torchrl.envs import PettingZooWrapper, check_env_specs

    import cp_env
    from tests.helpers.stand_in_town import Sketch

    env = PettingZooWrapper(cp_env.parallel_env("prbi", scenes=Sketch(), max_frames=3, **options), return_state=True)
    check_env_specs(env)
    group = "vehicle" if "slots" in options else "adversary"
    rollout = env.rollout(3)
    assert rollout["state"].shape == (3, 5, 128, 32, 32)
    assert list(env.group_map) == [group] and rollout[group, "action"].shape[1] == len(env.group_map[group])


def test_the_same_seed_is_the_same_rollout() -> None:
    import torch
    from torchrl.envs import PettingZooWrapper

    import cp_env
    from tests.helpers.stand_in_town import Sketch

    def play(seed: int) -> Any:
        env = PettingZooWrapper(cp_env.parallel_env("none", scenes=Sketch(), observation="compact", max_frames=3))
        env.set_seed(seed)
        torch.manual_seed(0)
        return env.rollout(3)

    a, b, other = play(1), play(1), play(2)
    assert bool((a == b).all()) and not torch.equal(a["adversary", "observation"], other["adversary", "observation"])
