"""coperception's truth in the grid frame: by hand, and beside the one in the ego's own frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from cp_env.detector.coperception.truth import their_truth
from cp_env.geometry.planar import compose, grid_origin, invert
from cp_env.metrics.ground_truth import truth_boxes
from cp_env.types import Scene
from tests.helpers.toy_scenes import toy_scene


def scene(*poses: tuple[float, float, float]) -> Scene:
    one = toy_scene(n_frames=1)
    return replace(one, pose=np.array([poses]), size=np.tile([4.0, 2.0, 1.5], (len(poses), 1)), connected=np.arange(1))


def test_by_hand() -> None:
    """The ego at (11, 7) looks north; its grid begins at (12, 8) or (10, 6), whichever lattice point rounding gives.

    A car 32.4 m ahead of it counts, one 32.6 m ahead does not; one at 40 m along the diagonal is in its square.
    """
    made = scene((11, 7, np.pi / 2), (12, 39.4, 0.3), (12, 39.6, 0.3), (11 - 28.2, 7 + 28.2, 0))
    origin = grid_origin(np.array([11.0, 7.0]))
    found = their_truth(made, 0, 0)
    expected = [[11, 7, 4, 2, np.pi / 2], [12, 39.4, 4, 2, 0.3], [11 - 28.2, 35.2, 4, 2, 0]]
    assert_allclose(found[:, :4], np.array(expected)[:, :4] - [*origin, 0, 0], atol=1e-5)
    assert_allclose(np.sin(found[:, 4] - np.array(expected)[:, 4]), 0, atol=1e-6)
    assert_allclose(their_truth(made, 0, 0, own=False), found[1:])


@pytest.mark.parametrize("seed", range(4))
def test_it_is_their_truth_in_another_frame(seed: int) -> None:
    """Turned back into the ego's own frame it is what `truth_boxes` says there."""
    rng = np.random.default_rng(seed)
    made = scene(*rng.uniform([-40, -40, -3], [40, 40, 3], (30, 3)).tolist())
    found = their_truth(made, 0, 4).astype(np.float64)
    ego = made.pose[0, 4] - [*grid_origin(made.pose[0, 4, :2]), 0]
    back = compose(np.broadcast_to(invert(ego), (len(found), 3)), found[:, [0, 1, 4]])
    theirs = truth_boxes(made, 0, 4, 32.0, "coperception", "ego")
    assert_allclose(back[:, :2], theirs[:, :2], atol=1e-4)
    assert_allclose(np.sin((back[:, 2] - theirs[:, 4]) / 2), 0, atol=1e-6)
    assert len(their_truth(made, 0, 4, own=False)) == len(theirs) - 1
