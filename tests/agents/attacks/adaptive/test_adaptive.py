"""Adaptive attacks do what they say: on random situations, and on real scenes under PRBI."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import agents
from cp_env.world.scene_cache import SceneBank
from defenders.protocol import Defender, Frame, Inspection, Verdict
from tests.helpers.attacked_scenes import play

# -- groups, places, times ---------------------------------------------------------------------------------------------


class Watchful(Defender):
    """Would notice an attack that changes it."""

    def reset(self, n_vehicles: int, rng: np.random.Generator) -> None:
        self.n, self.frames = n_vehicles, 0

    def inspect(self, frame: Frame) -> Inspection:
        yield from ()
        self.frames += 1
        assert self.frames == frame.index + 1, "this very object judged in between"
        return Verdict(range(self.n))


@pytest.mark.parametrize("attack", ["eot", "framing"])
def test_simulating_never_changes_the_defender(street: SceneBank, attack: str) -> None:
    assert not any(error for o in play(street, attack, Watchful(), steps=1) for error in o.errors)


@pytest.mark.parametrize(
    ("attack", "options", "message"),
    [
        ("in_loop", {"reference": "truth"}, "output, ego"),
        ("in_loop", {"threshold": 0.9, "margin": 0.2}, r"\[0, 1\]"),
        ("in_loop", {"groups": "pairs"}, "teams, halves, splits"),
        ("eot", {"groups": "pairs"}, "teams, halves, splits"),
        ("eot", {"draws": 0}, "draws"),
        ("framing", {"victim": -1}, "victim"),
        ("poison", {"colour": 1}, "poison"),
        ("ramp", {"first": 2.0}, "first=2"),
    ],
)
def test_bad_options_are_refused(attack: str, options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        agents.make(attack, **options)
