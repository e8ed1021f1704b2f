"""Returns and boxes, counted by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cp_env.scenes.preview.box_fit import fit, share_inside
from cp_env.types import Scene, Sweep
from tests.helpers.toy_scenes import ToySource

# a car at (10, 0) along x: 4 × 2 m; one at (10, 5) along y; the ego at the origin
SCENE = Scene(
    name="by hand",
    kind="recorded",
    dt=0.2,
    pose=np.array([[[0, 0, 0], [10, 0, 0], [10, 5, np.pi / 2], [np.nan] * 3]]),
    size=np.tile([4.0, 2.0, 1.5], (4, 1)),
    connected=np.array([0]),
    rsu=None,
    obstacles=np.array([[10.0, -2.5, 0.0, 8.0, 1.0, 5.0]]),  # from y = -3 to -2
)
TAIL = [[8.0 + 0.01 * k, 0.1 * k, 1.0] for k in range(-4, 5)]  # nine on the car's tail


def sweep(*points: list[float], hits: list[int] | None = None) -> Sweep:
    given = None if hits is None else np.array(hits)
    return Sweep(np.array(points, dtype=np.float32), np.array([0.0, 0.0, 1.8]), given)


def test_returns_in_the_box_and_around_it() -> None:
    """Nine on the tail; beside it three on the road, two in the other car's box, four on a wall, one too high."""
    around = [[9.0, 1.5, 0.1]] * 3 + [[10.0, 3.2, 1.0]] * 2 + [[9.5, -1.9, 1.0]] * 4 + [[9.0, 1.5, 2.6]]
    found = fit(SCENE, 0, 0, sweep(*TAIL, *around))
    assert (found.rows.tolist(), found.inside.tolist(), found.returns.tolist()) == ([1], [9], [9])
    assert not found.missed.any() and share_inside([found, found]) == (2, 2)


@pytest.mark.parametrize(("stray", "missed"), [(5, False), (6, False), (7, True)])
def test_a_box_is_missed_if_more_than_four_in_ten_lie_outside(stray: int, missed: bool) -> None:
    """Nine of 15 are 0.6, nine of 16 less. They lie 0.5 m beyond the left side; 1.2 m ahead, nobody's."""
    found = fit(SCENE, 0, 0, sweep(*TAIL, *[[10.0, 1.5, 1.0]] * stray, *[[13.2, 0.0, 1.0]] * 20))
    assert (found.inside.tolist(), found.returns.tolist()) == ([9], [9 + stray])
    assert found.missed.tolist() == [missed] and share_inside([found]) == (1 - missed, 1)


def test_boxes_are_a_little_larger() -> None:
    found = fit(SCENE, 0, 0, sweep(*[[7.85, 0.0, 1.0]] * 6, *[[7.75, 0.0, 1.0]] * 2))
    assert (found.inside.tolist(), found.returns.tolist()) == ([6], [8]), "0.15 m is in, 0.25 m is beside"


def test_what_the_source_says_counts() -> None:
    """Told that twenty returns are the car's, of which nine lie in its box; the other car's are all elsewhere."""
    found = fit(SCENE, 0, 0, sweep(*TAIL, hits=[0, 20, 7, 0]))
    assert (found.rows.tolist(), found.returns.tolist()) == ([1, 2], [20, 7])
    assert found.missed.tolist() == [True, True] and share_inside([found]) == (0, 2)


def test_a_second_box_in_the_same_place_excuses_nothing() -> None:
    """A car given twice, 0.45 m to the left and to the right of where it stands: each holds half, and misses half."""
    twice = SCENE.pose.copy()
    twice[0, 1:3] = [[10, 0.45, 0], [10, -0.45, 0]]
    sides = [[9 + k / 10, side, 1.0] for side in (0.9, -0.9) for k in range(9)]
    found = fit(replace(SCENE, pose=twice, obstacles=np.zeros((0, 6))), 0, 0, sweep(*sides))
    assert (found.rows.tolist(), found.inside.tolist(), found.returns.tolist()) == ([1, 2], [9, 9], [18, 18])
    assert found.missed.all()


def test_few_returns_and_far_vehicles_and_the_carrier_are_not_judged() -> None:
    own = [[0.5, 0.5, 1.0]] * 9
    assert not len(fit(SCENE, 0, 0, sweep(*TAIL[:4], *own)).rows)
    far = replace(SCENE, pose=SCENE.pose + np.array([25.0, 0, 0]) * (np.arange(4) == 1)[:, None])
    assert not len(fit(far, 0, 0, sweep(*([x + 25, y, z] for x, y, z in TAIL))).rows)
    nobody = fit(SCENE, 0, 0, sweep([0.0, 9.0, 0.0]))
    assert share_inside([nobody]) == share_inside([]) == (0, 0)
    unit = fit(SCENE, 0, 1, sweep(*own))
    assert unit.rows.tolist() == [0], "the second sweep is a road-side unit's: it carries nobody"


def test_the_toys_returns_lie_in_their_boxes() -> None:
    """And mirrored they do not, whatever the ray-caster says about who returned them."""
    toy = ToySource(n_frames=1, n_connected=3)
    for name in toy.names():
        scene = toy.load(name)
        (sweeps,) = toy.sweeps(scene, [0])
        good, met = share_inside([fit(scene, 0, agent, one) for agent, one in enumerate(sweeps)])
        assert met > 25 and good == met
        mirror = np.float32([-1, 1, 1])
        mirrored = [replace(one, points=one.points * mirror) for one in sweeps]
        good, met = share_inside([fit(scene, 0, agent, one) for agent, one in enumerate(mirrored)])
        assert good < met / 2
