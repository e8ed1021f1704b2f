"""A scene of DAIR-V2X-C out of its frames: pieces, the ego among the labels, the road, the unit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from cp_env.scenes.dair_v2x.build import FrameSequence, build, pieces
from cp_env.scenes.dair_v2x.files import Labels, Pair
from cp_env.scenes.errors import BrokenData
from cp_env.scenes.opv2v.classes import DEFAULT, Choice

FRAMES = 4
PAIRS = [Pair(f"{t:06d}", f"{t + 9:06d}", "3", 100_000 * t, None) for t in range(FRAMES)]


def motion(x: float, y: float, z: float) -> np.ndarray:
    return np.column_stack([np.eye(3), [x, y, z]])


def labels(*boxes: tuple[str, float, float, float]) -> Labels:
    """Upright cars of 4 × 2 × 1.5 m that look east: kind, x, y, z of the floor."""
    rows = [[x, y, z + 0.75, 4.0, 2.0, 1.5, 0.0] for _, x, y, z in boxes]
    return Labels(tuple(kind for kind, *_ in boxes), np.array(rows).reshape(-1, 7), np.zeros((len(boxes), 2)))


def made(seen: list[Labels], unit: list[np.ndarray] | None = None, *, sender: bool = True) -> FrameSequence:
    """The ego's LiDAR drives east at 5 m/s, 2 m over a road that is 10 m up; the unit's hangs at (20, 10), 6 m up."""
    poses = np.array([[motion(0.5 * t, 0, 12), unit[t] if unit else motion(20, 10, 16)] for t in range(FRAMES)])
    return build(Path("set"), "batch-3", PAIRS, seen, poses, Choice.of(DEFAULT), sender=sender)


def test_pieces_by_hand() -> None:
    """Times by 100 ms that jitter by some; a hole of three frames after the fourth."""
    times = [0, 101_000, 199_000, 300_000, 700_000, 801_000, 900_000]
    assert pieces(times, 1) == [[0, 1, 2, 3], [4, 5, 6]]
    assert (
        pieces(times, 2) == [[0, 2], [5]] or pieces(times, 2) == [[0, 2], [6]] or pieces(times, 2) == [[0, 2], [4, 6]]
    )
    assert pieces(times, 1, {2}) == [[0, 1], [3], [4, 5, 6]]
    assert pieces([5], 2) == [[0]] and pieces([5], 2, {0}) == []


def test_the_ego_is_what_is_labelled_under_its_lidar() -> None:
    """It is labelled in two frames, 0.3 m behind its LiDAR, among others; in the others it stands there too."""
    seen = [labels(("car", 0.5 * t - 0.3, 0, 10), ("van", 15, 4, 10)) for t in range(FRAMES)]
    seen[1] = seen[3] = labels(("van", 15, 4, 10))
    found = made(seen)
    assert found.kinds == ("car", "unit", "van") and found.scene.connected.tolist() == [0, 1]
    assert_allclose(found.scene.pose[:, 0, 0], [0.5 * t - 0.3 for t in range(FRAMES)], atol=1e-9)
    assert_allclose(found.scene.pose[:, 2], [[15, 4, 0]] * FRAMES, atol=1e-9)
    assert_allclose(found.level, 10, atol=1e-6)
    assert_allclose(found.boxes[:, 0, 2], 10.75, atol=1e-6)


def test_the_unit_is_a_sender_or_a_road_side_unit() -> None:
    seen = [labels(("car", 15, 4, 10))] * FRAMES
    sender, rsu = made(seen), made(seen, sender=False)
    assert sender.scene.rsu is None and rsu.scene.connected.tolist() == [0]
    assert rsu.scene.rsu is not None and rsu.kinds == ("vehicle", "car")
    assert_allclose(rsu.scene.rsu, [20, 10, 6], atol=1e-6)
    assert_allclose(sender.scene.pose[:, 1], [[20, 10, 0]] * FRAMES) and sender.scene.dt == pytest.approx(0.1)
    assert_allclose(sender.scene.size[1], [0.4, 0.4, 6], atol=1e-6)
    assert np.isnan(sender.feet[:, 1]).all(), "a mast says nothing of the road"


def test_the_road_is_the_median_over_vehicles_near_the_lidar() -> None:
    """Boxes are drawn by hand: one frame's is 0.4 m too high. A car 80 m ahead on another road does not matter."""
    seen = [labels(("car", 8, 4, 10.4 if t == 1 else 10.0), ("car", 80, 0, 14)) for t in range(FRAMES)]
    assert np.abs(made(seen).level[:, 0] - 10).max() < 0.2
    assert_allclose(made([labels()] * FRAMES).level, 12 - 1.9, atol=1e-6)


def test_offsets_move_the_unit_by_little() -> None:
    near = [motion(20 + 0.5 * (t == 2), 10, 16) for t in range(FRAMES)]
    assert_allclose(made([labels()] * FRAMES, near).place[:, 1], [[20, 10]] * FRAMES)
    with pytest.raises(BrokenData, match=r"virtuallidar_to_world.000012\.json: the unit is 9\.0 m from where"):
        made([labels()] * FRAMES, [motion(20, 10, 16)] * 3 + [motion(29, 10, 16)])


def test_classes_choose_and_unknown_ones_are_named() -> None:
    seen = [labels(("Bus", 15, 4, 10), ("pedestrian", 9, 3, 10))] * FRAMES
    assert made(seen).kinds == ("vehicle", "unit", "Bus")
    bad = [replace(seen[0], kinds=("Bus", "zeppelin"))] * FRAMES
    with pytest.raises(BrokenData, match=r"label_world.000000\.json: .*zeppelin.*classes=vehicle,zeppelin"):
        made(bad)
