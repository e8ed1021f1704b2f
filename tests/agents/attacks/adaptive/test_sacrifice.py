"""The coalition that gives one attacker away."""

from __future__ import annotations

import numpy as np
import pytest

import agents
from cp_env.world.scene_cache import SceneBank
from tests.helpers.attacked_scenes import play


def test_the_silent_ones_send_nothing_until_the_verdict_has_converged(street: SceneBank) -> None:
    outcomes = play(street, "sacrifice", seed=3)  # of seeds 1 to 8 half converge in both worlds within five frames
    settled = np.array([[v.converged and 2 not in v.collaborators for v in o.verdicts] for o in outcomes])
    spoke = np.array([o.perturbation_norm[:, 0] > 0 for o in outcomes])
    assert settled.any() and spoke.any(), "the test needs a verdict that converges"
    assert np.array_equal(spoke[1:], settled[:-1]) and not spoke[0].any()


def test_its_options_are_those_of_the_ascent_and_no_other() -> None:
    assert agents.make("sacrifice:steps=2,restarts=2").restarts == 2  # type: ignore[attr-defined]
    for option in ("wisdom", "target_groups", "optimizer"):
        with pytest.raises(ValueError, match=f"unknown option of attack 'sacrifice' '{option}'"):
            agents.make("sacrifice", **{option: "all"})
