"""Ground truth: who is in range of the ego, and where."""

from __future__ import annotations

import math

import numpy as np
import pytest

from cp_env.metrics.ground_truth import rows_in_range, truth_boxes
from cp_env.types import Scene

NAN = math.nan


@pytest.fixture
def scene() -> Scene:
    """Two frames, six vehicles; the ego (row 1) drives 10 m east in between.

    Row 0 stands 5 m ahead of it, 2 is just inside the square range (but 45 m off), 3 just outside, 4 appears in
    the second frame, 5 is far away.
    """
    first = [[105, 50, 0.5], [100, 50, 0], [131.9, 81.9, 1], [132.1, 50, 2], [NAN, NAN, NAN], [300, 50, 0]]
    second = [[105, 50, 0.5], [110, 50, 0], [131.9, 81.9, 1], [132.1, 50, 2], [110, 40, 3], [300, 50, 0]]
    return Scene(
        name="by hand",
        kind="urban",
        dt=0.2,
        pose=np.array([first, second], dtype=np.float64),
        size=np.array([[4.0 + row, 2.0 + row / 10, 1.5] for row in range(6)]),
        connected=np.array([1, 0]),
        rsu=None,
        obstacles=np.zeros((0, 6)),
    )


def test_who_is_in_range(scene: Scene) -> None:
    assert rows_in_range(scene, 0, ego=1, extent=32.0).tolist() == [0, 2]
    assert rows_in_range(scene, 1, ego=1, extent=32.0).tolist() == [0, 2, 3, 4]
    assert rows_in_range(scene, 0, ego=0, extent=32.0).tolist() == [1, 2, 3]
    assert rows_in_range(scene, 0, ego=1, extent=32.2).tolist() == [0, 2, 3]
    assert rows_in_range(scene, 0, ego=5, extent=32.0).tolist() == []


def test_boxes_lie_in_the_grid_frame(scene: Scene) -> None:
    """Moved by the ego's position, not turned by its heading."""
    boxes = truth_boxes(scene, 1, ego=1, extent=32.0)
    expected = [[-5, 0, 4, 2, 0.5], [21.9, 31.9, 6, 2.2, 1], [22.1, 0, 7, 2.3, 2], [0, -10, 8, 2.4, 3]]
    np.testing.assert_allclose(boxes, expected, rtol=1e-6, atol=1e-6)
    turned = Scene(**{**vars(scene), "pose": scene.pose + np.array([0, 0, 1.0]) * (np.arange(6) == 1)[:, None]})
    np.testing.assert_array_equal(truth_boxes(turned, 1, ego=1, extent=32.0), boxes)


def test_nobody_in_range_is_an_empty_array(scene: Scene) -> None:
    assert truth_boxes(scene, 0, ego=5, extent=32.0).shape == (0, 5)


def test_the_whole_world_may_move(scene: Scene) -> None:
    moved = Scene(**{**vars(scene), "pose": scene.pose + np.array([1000.0, -500.0, 0.0])})
    np.testing.assert_allclose(truth_boxes(moved, 0, 1, 32.0), truth_boxes(scene, 0, 1, 32.0), atol=1e-5)


def test_the_grid_begins_on_the_lattice(scene: Scene) -> None:
    """An ego 0.9 m short of the lattice point at (102, 50) has its grid, and so its range, there."""
    pose = scene.pose.copy()
    pose[0, 1] = [101.1, 50.3, 0.2]
    shifted = Scene(**{**vars(scene), "pose": pose})
    assert rows_in_range(shifted, 0, ego=1, extent=32.0).tolist() == [0, 2, 3]
    np.testing.assert_allclose(truth_boxes(shifted, 0, 1, 32.0)[0], [3, 0, 4, 2, 0.5], atol=1e-5)


def test_truth_as_coperception_counts_it(scene: Scene) -> None:
    """Half a metre farther than the map, that limit included, and with the ego's own car."""
    assert rows_in_range(scene, 0, 1, 32.0, "coperception").tolist() == [0, 1, 2, 3]
    own = truth_boxes(scene, 0, 1, 32.0, "coperception")[1]
    np.testing.assert_allclose(own, [0, 0, 5, 2.1, 0], atol=1e-6)
    pose = scene.pose.copy()
    for x, counts in ((132.5, True), (132.6, False), (67.5, True), (67.4, False)):
        pose[0, 3, 0] = x
        moved = Scene(**{**vars(scene), "pose": pose})
        assert (3 in rows_in_range(moved, 0, 1, 32.0, "coperception")) == counts
        assert 3 not in rows_in_range(moved, 0, 1, 32.0)
    assert rows_in_range(scene, 0, 5, 32.0, "coperception").tolist() == [5]


def test_truth_along_the_egos_axes(scene: Scene) -> None:
    """The ego looks north from (100.3, 50.4): what is 5 m east of it is on its right, at y = -4.7 m."""
    pose = scene.pose.copy()
    pose[0, 1] = [100.3, 50.4, math.pi / 2]
    turned = Scene(**{**vars(scene), "pose": pose})
    boxes = truth_boxes(turned, 0, 1, 32.0, axes="ego")
    np.testing.assert_allclose(boxes[0], [-0.4, -4.7, 4, 2, 0.5 - math.pi / 2], atol=1e-5)
    theirs = truth_boxes(turned, 0, 1, 32.0, "coperception", "ego")
    np.testing.assert_allclose(theirs[1], [0, 0, 5, 2.1, 0], atol=1e-6)


def test_a_square_that_turns_with_the_ego_holds_others(scene: Scene) -> None:
    """Turned by 45° the square reaches 45 m east, and 22 m northeast: row 2, at (31.9, 31.9), is out of it."""
    pose = scene.pose.copy()
    pose[0, 1, 2] = math.pi / 4
    pose[0, 3, :2] = [145.9, 50]
    turned = Scene(**{**vars(scene), "pose": pose})
    assert rows_in_range(turned, 0, 1, 32.0, "coperception", "ego").tolist() == [0, 1, 3]
    assert rows_in_range(turned, 0, 1, 32.0, "coperception").tolist() == [0, 1, 2]


def test_unknown_choices_of_truth_are_refused(scene: Scene) -> None:
    with pytest.raises(ValueError, match="unknown protocol 'voc' of the truth"):
        truth_boxes(scene, 0, 1, 32.0, "voc")
    with pytest.raises(ValueError, match="must be 'grid' or 'ego', not 'world'"):
        rows_in_range(scene, 0, 1, 32.0, axes="world")
