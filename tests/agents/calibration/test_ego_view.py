"""What the thresholds of ROBOSAC and PASAC rest on; their errors by hand are in test_samples.py."""

from __future__ import annotations

from agents.calibration.ego_view import SCORES, survey, thresholds
from cp_env.world.scene_cache import SceneBank


def test_groups_with_the_ego_and_others_alone(toy_bank: SceneBank) -> None:
    """The ego is benign, so it never makes an attacker of a group; frame 0 counts, without grace."""
    found = survey(
        toy_bank, ("toy-0",), n_vehicles=3, frames=2, attack="pgd:steps=2", seed=0, track=lambda jobs, _: jobs
    )
    assert set(found) == set(SCORES)
    for samples in found.values():
        counts = {key: len(values["toy-0"]) for key, values in samples.items()}
        # k = 0, 1, 2 of the two others, in two frames each: pairs {0, 1}, {0, 2}, the three, and {1}, {2} alone
        assert counts == {(1, 0): 6, (1, 1): 6, (2, 0): 6, (2, 1): 6, (3, 0): 2, (3, 1): 2, (3, 2): 2}
    assert all(0 <= score <= 0.5 for key in found["agreement"] for score in found["agreement"][key]["toy-0"])
    for score in SCORES:
        assert all(0 <= epsilon <= 1 for epsilon in thresholds(found[score], 3).values())


def test_the_frames_are_drawn_from_the_whole_scene(toy_bank: SceneBank, starts: list[int]) -> None:
    """Two of five frames: the first of them is frame 0, 1, 2 or 3, each in some of 30 episodes."""
    for seed in range(10):
        survey(toy_bank, ("toy-0",), n_vehicles=3, frames=2, attack="noise", seed=seed, track=lambda jobs, _: jobs)
    assert set(starts) == {0, 1, 2, 3}
