"""Places of a large network that a scene is taken from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import shapely

from cp_env.scenes.sumo import places, selection
from cp_env.scenes.sumo.network import Lane
from cp_env.scenes.sumo.places import focus, meetings, quarter
from cp_env.scenes.sumo.traffic import Tracks
from tests.helpers.toy_traffic import line_of_cars, town_without_streets


def far_apart() -> Tracks:
    """Four that stand 10 m apart at the origin, five 1 km away that drive 30 m along y in twenty seconds."""
    standing, driving = line_of_cars(4, 10.0), line_of_cars(5, 10.0)
    driving.pose[..., 0] += 1000
    driving.pose[..., 1] = np.linspace(0, 30, selection.FRAMES)[:, None]
    pose = np.concatenate([standing.pose, driving.pose], axis=1)
    return Tracks(pose, np.concatenate([standing.size, driving.size]))


def test_meetings_by_hand() -> None:
    """The five meet, and each is a place; the four do where four are enough and standing ones count."""
    five = meetings(far_apart(), 5, moving=True)
    assert np.allclose(five[:, 0], 1000 + 10 * np.arange(5))
    assert np.allclose(five[:, 1:], [15, 15], atol=0.5)
    assert len(meetings(far_apart(), 4, moving=True)) == 5 and len(meetings(far_apart(), 4, moving=False)) == 9
    assert meetings(far_apart(), 6, moving=False).shape == (0, 3)
    assert meetings(Tracks(np.zeros((0, 0, 3)), np.zeros((0, 3))), 2, moving=False).shape == (0, 3)


def test_meetings_agree_with_trying_every_pair() -> None:
    rng = np.random.default_rng(0)
    pose = np.concatenate([rng.uniform(0, 150, (1, 20, 2)), np.zeros((1, 20, 1))], axis=2)
    drift = np.concatenate([rng.normal(0, 1.0, (20, 2)), np.zeros((20, 1))], axis=1)
    pose = pose + drift * 0.2 * np.arange(selection.FRAMES)[:, None, None]
    place = pose[:: selection.SAMPLE, :, :2]
    gap = np.linalg.norm(place[:, :, None] - place[:, None], axis=-1).max(axis=0)
    expected = ((gap < selection.RADIO - 1).sum(axis=1) >= 5).sum()
    assert 0 < expected < 20
    assert len(meetings(Tracks(pose, np.ones((20, 3))), 5, moving=False)) == expected


def test_the_focus_follows_the_ego_as_far_as_it_goes() -> None:
    town = replace(
        town_without_streets(9000),
        lanes=[Lane(str(x), 0, np.array([[x, -50.0], [x, 50.0]]), 3.2, False) for x in (0.0, 200.0, 400.0, 3000.0)]
        + [Lane("through", 0, np.array([[-5000.0, 0.0], [5000.0, 0.0]]), 3.2, False)],
        carriageway=shapely.box(-5000, -2, 5000, 2),
        junctions=np.array([[0.0, 0.0, 1.0], [900.0, 0.0, 0.0]]),
    )
    tracks = line_of_cars(4, 250.0)
    near, rows = focus(town, tracks, np.array([0.0, 0.0, 20.0]))
    assert [lane.edge for lane in near.lanes] == ["0.0", "200.0", "through"] and rows.tolist() == [0, 1]
    assert len(near.junctions) == 1 and near.radius == places.AROUND - 100 and near.centre.tolist() == [0, 0]
    assert np.allclose(near.carriageway.bounds, [-270, -2, 270, 2])
    far, rows = focus(town, tracks, np.array([0.0, 0.0, 400.0]))
    assert far.radius == 410 and rows.tolist() == [0, 1, 2], "at 40 m/s it goes 400 m either way"


def test_of_streets_longer_than_the_quarter_those_that_pass_through_are_taken() -> None:
    long = [np.array([[0.0, y], [2000.0, y]]) for y in (0.0, 300.0, 3000.0)]
    lanes = [Lane(str(k), 0, shape, 3.2, False) for k, shape in enumerate(long)]
    town = replace(town_without_streets(np.inf), lanes=lanes, sources=["0", "2"], sinks=["1"])
    taken = {tuple(lane.edge for lane in quarter(town, np.random.default_rng(seed)).lanes) for seed in range(9)}
    assert taken == {("0", "1"), ("2",)}
