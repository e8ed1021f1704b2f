"""BenchMARL trains MAPPO and IPPO on a task of the environment."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

pytest.importorskip("benchmarl", reason="make library-benchmarl")
pytestmark = pytest.mark.filterwarnings("default")
Run = Callable[[str], dict[str, Any]]


def test_the_page(sketched_page: Run) -> None:
    """MAPPO as the page trains it, then IPPO on the same task."""
    import torch
    from benchmarl.algorithms import IppoConfig
    from benchmarl.experiment import Experiment
    from benchmarl.models.mlp import MlpConfig

    names = sketched_page("docs/benchmarl.md")
    assert names["experiment"].total_frames == 16 and names["experiment"].group_map == {
        "adversary": ["adversary_0", "adversary_1"]
    }
    experiment = Experiment(
        task=names["task"],
        algorithm_config=IppoConfig.get_from_yaml(),
        model_config=MlpConfig.get_from_yaml(),
        seed=1,
        config=names["config"],
    )
    before = [p.clone() for p in experiment.losses["adversary"].parameters()]
    experiment.run()
    after = list(experiment.losses["adversary"].parameters())
    assert experiment.total_frames == 16
    assert any(not torch.equal(a, b) for a, b in zip(before, after, strict=True)), "nothing was learnt"
    assert all(torch.isfinite(p).all() for p in after)
