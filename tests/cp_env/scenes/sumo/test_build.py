"""Scenes built of tracks: collisions and swept ground."""

from __future__ import annotations

import numpy as np
import shapely

from cp_env.scenes.sumo import build, roadside
from tests.helpers.toy_traffic import line_of_cars


def test_of_two_that_drive_through_each_other_the_connected_one_stays() -> None:
    tracks = line_of_cars(5, 10.0)
    pose = tracks.pose.copy()
    pose[50:, 1, 0] = pose[50:, 2, 0] + 1.0  # the second drives into the third
    pose[:, 4] = np.nan
    assert build._peaceful(pose, tracks.size, np.array([0, 1])).tolist() == [0, 1, 3]
    assert build._peaceful(pose, tracks.size, np.array([0, 2])).tolist() == [0, 2, 3]


def test_swept_ground_covers_every_box() -> None:
    rng = np.random.default_rng(0)
    pose = np.cumsum(rng.normal(0.6, 0.2, (40, 3, 3)) * [1, 1, 0.05], axis=0)
    pose[:13, 2] = np.nan
    size = np.tile([4.5, 1.8, 1.5], (3, 1))
    ground = shapely.union_all(build._swept(pose, size))
    for frame in pose[::3]:
        here = ~np.isnan(frame[:, 0])
        assert shapely.covers(
            ground.buffer(1e-6), roadside.footprints(np.column_stack([frame[here], size[here]]))
        ).all()
