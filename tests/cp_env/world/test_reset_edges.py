"""Every draw of a reset reaches its whole range and nothing beyond it; what is named changes no other draw."""

from __future__ import annotations

from typing import Any

import pytest

from cp_env.settings import Settings
from cp_env.world.reset import EpisodePlan, plan_episode
from cp_env.world.scene_cache import SceneBank
from cp_env.world.streams import Stream

FRAMES = 6
"""Frames of the toy crossings."""


def plans(bank: SceneBank, options: dict[str, Any] | None = None, **settings: Any) -> list[EpisodePlan]:
    return [plan_episode(bank, Settings(**settings), Stream.of(seed), options or {}) for seed in range(80)]


@pytest.mark.parametrize("max_frames", [1, 3, 5, 6, 9])
def test_every_start_that_leaves_room_is_drawn_and_no_other(bank: SceneBank, max_frames: int) -> None:
    starts = {plan.start for plan in plans(bank, max_frames=max_frames)}
    assert starts == set(range(max(FRAMES - max_frames, 0) + 1))


def test_a_start_may_be_any_frame_of_the_scene_and_no_other(bank: SceneBank) -> None:
    for start in range(FRAMES):
        assert plan_episode(bank, Settings(), Stream.of(0), {"start": start}).start == start
    for start in (-1, FRAMES, True):
        with pytest.raises(ValueError, match=f"start must be a frame of scene .*, 0 to {FRAMES - 1}, not {start}"):
            plan_episode(bank, Settings(), Stream.of(0), {"start": start})


@pytest.mark.parametrize(("k", "rsu"), [(1, False), (2, True), (4, True), (0, False)])
def test_attackers_are_k_different_vehicles_and_each_is_drawn(bank: SceneBank, k: int, rsu: bool) -> None:
    """The road-side unit attacks only where it is named."""
    drawn = [plan.attackers for plan in plans(bank, n_attackers=k, rsu=rsu)]
    assert all(len(set(attackers)) == k and list(attackers) == sorted(attackers) for attackers in drawn)
    assert {i for attackers in drawn for i in attackers} == (set(range(5)) if k else set())
    named = plan_episode(bank, Settings(attackers=(5, 2), rsu=True), Stream.of(0), {})
    assert named.attackers == (2, 5)


def test_to_name_what_would_be_drawn_changes_nothing(bank: SceneBank) -> None:
    for drawn, seed in zip(plans(bank, max_frames=2), range(80), strict=True):
        for options in ({"scene": drawn.scene}, {"scene": drawn.scene, "start": drawn.start}):
            named = plan_episode(bank, Settings(max_frames=2), Stream.of(seed), options)
            assert (named.scene, named.start, named.attackers) == (drawn.scene, drawn.start, drawn.attackers)
