"""The beginning of every scene: fewer frames, fewer vehicles, and nothing else changed."""

from __future__ import annotations

import numpy as np
import pytest

from cp_env.scenes.clip import Clip
from tests.helpers.toy_scenes import ToySource

WHOLE = ToySource(n_frames=4, n_connected=3)


def test_frames_and_vehicles_are_the_first() -> None:
    scene, whole = Clip(WHOLE, frames=2, vehicles=2).load("toy-1"), WHOLE.load("toy-1")
    assert scene.n_frames == 2 and scene.connected.tolist() == [0, 1]
    assert np.array_equal(scene.pose, whole.pose[:2]) and np.array_equal(scene.size, whole.size)


def test_sweeps_are_those_of_the_vehicles_that_stay_and_of_the_road_side_unit() -> None:
    clip = Clip(WHOLE, vehicles=2)
    (ours,), (theirs,) = clip.sweeps(clip.load("toy-0"), [3]), WHOLE.sweeps(WHOLE.load("toy-0"), [3])
    assert len(theirs) == 4 and len(ours) == 3
    for mine, its in zip(ours, (theirs[0], theirs[1], theirs[3]), strict=True):
        assert np.array_equal(mine.points, its.points) and np.array_equal(mine.origin, its.origin)


def test_every_clip_has_a_digest_of_its_own() -> None:
    clips = [Clip(WHOLE), Clip(WHOLE, frames=2), Clip(WHOLE, vehicles=2), Clip(WHOLE, frames=2, vehicles=2)]
    assert len({clip.digest for clip in clips} | {WHOLE.digest}) == 5
    assert {clip.names() for clip in clips} == {WHOLE.names()}


def test_more_than_there_is_changes_nothing() -> None:
    scene = Clip(WHOLE, frames=99, vehicles=99).load("toy-0")
    assert scene.n_frames == 4 and scene.n_connected == 3


@pytest.mark.parametrize("asked", [{"frames": 0}, {"vehicles": 0}])
def test_fewer_than_one_is_refused(asked: dict[str, int]) -> None:
    with pytest.raises(ValueError, match=f"{next(iter(asked))} must be at least 1, not 0"):
        Clip(WHOLE, **asked)
