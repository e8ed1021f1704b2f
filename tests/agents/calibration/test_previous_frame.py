"""What PRBI's thresholds rest on."""

from __future__ import annotations

from math import comb

from agents.calibration.previous_frame import GRID, survey, thresholds
from cp_env.world.scene_cache import SceneBank


def test_every_group_is_compared_in_every_frame_but_the_first(toy_bank: SceneBank) -> None:
    """Of each size and number of attackers as many as there are: k malicious of 3 vehicles, two frames compared."""
    found = survey(
        toy_bank, ("toy-0",), n_vehicles=3, frames=3, attack="pgd:steps=2", seed=0, track=lambda jobs, _: jobs
    )
    for k in range(3):
        for size in range(1, 4):
            for attackers in range(max(size - 3 + k, 0), min(size, k) + 1):
                assert (size, attackers) in found
    for size in range(1, 4):
        expected = sum(
            2 * comb(k, d) * comb(3 - k, size - d)
            for k in range(3)
            for d in range(1, min(size, k) + 1)
            if size - d <= 3 - k
        )
        assert sum(len(found[key]["toy-0"]) for key in found if key[0] == size and key[1] > 0) == expected
    epsilon = thresholds(found, 3)
    assert sorted(epsilon) == [1, 2, 3] and all(GRID[0] <= value <= GRID[-1] for value in epsilon.values())


def test_the_same_seed_measures_the_same(toy_bank: SceneBank) -> None:
    def again(seed: int) -> object:
        options = {"n_vehicles": 2, "frames": 2, "attack": "noise", "seed": seed}
        return survey(toy_bank, ("toy-0", "toy-1"), track=lambda jobs, _: jobs, **options)

    assert again(3) == again(3) and again(3) != again(4)


def test_the_frames_are_drawn_from_the_whole_scene(toy_bank: SceneBank, starts: list[int]) -> None:
    """Two of five frames: the first of them is frame 0, 1, 2 or 3, each in some of 30 episodes."""
    for seed in range(10):
        survey(toy_bank, ("toy-0",), n_vehicles=3, frames=2, attack="noise", seed=seed, track=lambda jobs, _: jobs)
    assert set(starts) == {0, 1, 2, 3}
