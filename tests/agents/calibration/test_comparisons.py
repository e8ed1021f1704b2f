"""What bayes rests on: which views are compared, and a killed run."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from agents.calibration import Plan
from agents.calibration.comparisons import all_groups, play, survey
from cp_env.world.scene_cache import SceneBank


def test_groups_are_numbered_by_their_bits() -> None:
    groups = all_groups(3)
    assert len(groups) == 7 and all(groups[sum(1 << i for i in group) - 1] == group for group in groups)


def test_an_episode_without_an_attack_has_every_age(toy_bank: SceneBank, small: Plan) -> None:
    found = play(toy_bank, "toy-0", "none", 0, small.episodes)
    assert found.similarity.shape == (4, 2, 7, 7) and found.full_view.shape == (4, 7)
    there = ~np.isnan(found.similarity).all(axis=(2, 3))
    assert there.tolist() == [[False, False], [True, False], [True, True], [True, True]]
    everyone = len(all_groups(3)) - 1
    assert (found.full_view[:, everyone] == 1).all(), "everyone's view is the full view"
    assert np.nanmin(found.similarity) >= 0 and np.nanmax(found.similarity) <= 1


def test_an_attacked_episode_has_the_frame_before_alone(toy_bank: SceneBank, small: Plan) -> None:
    found = play(toy_bank, "toy-0", small.episodes.loud, 1, small.episodes)
    assert len(found.attackers) == 1
    assert np.isnan(found.similarity[:, 1]).all() and not np.isnan(found.similarity[1:, 0]).any()
    first = play(toy_bank, "toy-0", small.episodes.loud, 1, small.episodes)
    np.testing.assert_array_equal(found.similarity, first.similarity)


def test_what_was_measured_is_not_measured_again(
    toy_bank: SceneBank, small: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def jobs(items: object, what: str) -> object:
        assert "groups" in what
        return items

    first = list(survey(toy_bank, ("toy-0",), small.episodes, tmp_path, jobs))  # type: ignore[arg-type]
    assert [(one.attack, len(one.attackers)) for one in first] == [
        ("none", 0),
        ("pgd:steps=2", 1),
        ("pgd:steps=2", 2),
        ("ramp:steps=1", 1),
        ("ramp:steps=1", 2),
    ]
    monkeypatch.setattr("agents.calibration.comparisons.play", None)
    for before, after in zip(first, survey(toy_bank, ("toy-0",), small.episodes, tmp_path, jobs), strict=True):  # type: ignore[arg-type]
        np.testing.assert_array_equal(before.similarity, after.similarity)
        assert before.attackers == after.attackers
