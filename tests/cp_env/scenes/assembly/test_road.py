"""The road through feet: by hand along a line, beside a slow twin of kriging, bridges, and whole sets on a hill."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from cp_env.scenes.assembly import road
from cp_env.scenes.assembly.road import DRAWN, EXACT, Road, under_unit
from cp_env.scenes.export import export
from cp_env.scenes.opv2v.source import OPV2V
from cp_env.scenes.v2xsim.source import V2XSim
from cp_env.testing import check_scenes
from cp_env.testing.scenes import LawBroken
from cp_env.types import SceneSource
from tests.helpers.hills import height, lift_opv2v, lift_v2x_sim
from tests.helpers.toy_scenes import ToySource

HERE = np.array([100.0, 50.0])
TOY = ToySource(n_frames=2, n_connected=3)


def test_between_two_feet_the_road_is_straight_and_beyond_them_level() -> None:
    """Feet at 0 and 3 m, 30 m apart: 0.75 m high at a quarter of the way, 3 m high 10 m beyond."""
    feet = np.array([[100.0, 50, 10], [130, 50, 13]])
    made = Road.through(feet, HERE, 10.0, softness=1e-9)
    assert_allclose(
        made.at(np.array([[0.0, 0], [7.5, 0], [15, 0], [30, 0], [40, 0], [-10, 0]])), [0, 0.75, 1.5, 3, 3, 0], atol=1e-6
    )
    soft = Road.through(feet, HERE, 10.0).at(np.array([[0.0, 0], [30, 0]]))
    assert_allclose(soft, [0, 3], atol=0.02)


@pytest.mark.parametrize("softness", [EXACT, DRAWN])
@pytest.mark.parametrize("seed", range(3))
def test_it_is_ordinary_kriging(seed: int, softness: float) -> None:
    """The slow twin: at each place the weights of least error variance that sum to one, for a linear variogram."""
    rng = np.random.default_rng(seed)
    feet = np.column_stack([HERE + rng.uniform(-40, 40, (12, 2)), rng.uniform(0, 0.5, 12)])
    places = rng.uniform(-50, 50, (7, 2))
    made = Road.through(feet, HERE, 0.0, softness).at(places)
    for place, found in zip(places, made, strict=True):
        system, right = np.ones((13, 13)), np.ones(13)
        system[12, 12] = 0
        for i in range(12):
            right[i] = -np.hypot(*(feet[i, :2] - HERE - place))
            for j in range(12):
                system[i, j] = softness if i == j else -np.hypot(*(feet[i, :2] - feet[j, :2]))
        assert found == pytest.approx(np.linalg.solve(system, right)[:12] @ feet[:, 2], abs=1e-8)


def test_a_level_road_changes_nothing_and_costs_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    feet = np.column_stack([HERE + np.arange(10)[:, None], np.linspace(9.95, 10.1, 10)])
    made = Road.through(feet, HERE, 10.0)
    points = np.ones((5, 3), dtype=np.float32)
    assert made.is_level and made.flatten(points) is points and not made.at(points[:, :2]).any()
    assert Road.through(np.full((3, 3), np.nan), HERE, 10.0).is_level


def test_who_stands_on_a_bridge_is_on_another_road() -> None:
    """6 m up at a distance of 15 m: no street is as steep. The same 6 m at 60 m are a hill."""
    bridge = Road.through(np.array([[100.0, 50, 10], [115, 50, 16]]), HERE, 10.0)
    hill = Road.through(np.array([[100.0, 50, 10], [160, 50, 16]]), HERE, 10.0)
    assert bridge.is_level and not hill.is_level


def test_many_points_are_looked_up_as_one_by_one() -> None:
    """The raster differs from the road itself by what it is bent within a cell of 4 m."""
    rng = np.random.default_rng(0)
    feet = np.column_stack([HERE + rng.uniform(-60, 60, (30, 2)), np.zeros(30)])
    feet[:, 2] = height(feet[:, 0], feet[:, 1])
    made = Road.through(feet, HERE, float(height(*HERE)))
    points = np.column_stack([rng.uniform(-70, 70, (500, 2)), rng.normal(size=500)]).astype(np.float32)
    exact = points[:, 2] - made.at(points[:, :2].astype(np.float64))
    assert np.abs(made.flatten(points)[:, 2] - exact).max() < 0.2
    assert (made.flatten(points)[:, :2] == points[:, :2]).all() and made.flatten(points).dtype == np.float32
    far = np.array([[300.0, 0, 0], [1e6, -1e6, 5]], dtype=np.float32)
    assert np.isfinite(made.flatten(far)).all()


def test_only_the_nearest_feet_are_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    """However many vehicles a file lists, memory and time are those of `MOST`."""
    monkeypatch.setattr(road, "MOST", 3)
    feet = np.array([[101.0, 50, 10.1], [110, 50, 11], [120, 50, 12], [130, 50, 9.5], [140, 50, 9.5]])
    assert_allclose(Road.through(feet, HERE, 10.0, softness=1e-9).at(np.array([[40.0, 0]])), [2.0], atol=1e-6)


def test_the_road_under_a_mast_is_the_median_of_its_frames() -> None:
    feet = np.array([[[90.0, 50, 9], [110, 50, 11]]] * 2 + [[[90.0, 50, 13], [110, 50, 15]]])
    assert under_unit(feet, HERE) == pytest.approx(10, abs=0.01)
    assert np.isnan(under_unit(np.full((2, 3, 3), np.nan), HERE)) and np.isnan(under_unit(np.zeros((2, 0, 3)), HERE))


SETS: dict[str, tuple[Callable[[Path], Path], Callable[[Path], SceneSource]]] = {
    "opv2v": (lift_opv2v, OPV2V),
    "v2x-sim": (lift_v2x_sim, lambda path: V2XSim(path, progress=False)),
}


@pytest.fixture(scope="module", params=SETS)
def hill(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> SceneSource:
    """The toy crossings on a hill whose vehicles stand up to 5 m above each other."""
    lift, read = SETS[request.param]
    return read(lift(export(TOY, tmp_path_factory.mktemp("hill") / "set", layout=request.param)))


def test_a_set_on_a_hill_keeps_the_laws(hill: SceneSource) -> None:
    check_scenes(hill)


def test_a_hill_is_read_as_the_flat_town_it_was(hill: SceneSource) -> None:
    """Places, headings, returns, and heights over the road, where vehicles stand round the point."""
    for name in TOY.names():
        scene, flat = hill.load(name), TOY.load(name)
        order = np.hypot(*(scene.pose[0, :, None, :2] - flat.pose[0, None, :, :2]).T).T.argmin(axis=1)
        assert np.abs(scene.pose[..., :2] - flat.pose[:, order, :2]).max() < 0.15, "a roof leans over its wheels"
        assert np.ptp(height(flat.pose[0, :, 0], flat.pose[0, :, 1])) > 3
        for row, expected in zip(hill.sweeps(scene, [0, 1]), TOY.sweeps(flat, [0, 1]), strict=True):
            for sweep, wanted in zip(row, expected, strict=True):
                assert wanted.hits is not None and sweep.hits is not None
                assert abs(int(sweep.hits.sum()) - int(wanted.hits.sum())) < 0.1 * wanted.hits.sum()
                near = np.hypot(*sweep.points[:, :2].T) < 20
                low = np.sort(sweep.points[near, 2])
                assert abs(np.median(low[: len(low) // 2])) < 0.2, "the lower half is road"
                assert abs(sweep.origin[2] - wanted.origin[2]) < 0.2


def test_without_the_road_a_hill_breaks_the_laws(hill: SceneSource, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Road, "flatten", lambda self, points: points)
    with pytest.raises(LawBroken, match=r"the_road_is_at_zero|boxes_hold|returns_lie|hits_lie"):
        check_scenes(hill)
