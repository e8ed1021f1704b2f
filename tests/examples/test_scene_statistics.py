"""The figures of a split, by hand on the toy crossing."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from examples.reproduce import scene_statistics as statistics
from tests.helpers.toy_scenes import ToySource, toy_scene


def test_counts_by_hand() -> None:
    """Four vehicles: seen by nobody, by one, by three, by all five."""
    by = np.zeros((5, 4), dtype=bool)
    by[0, 1] = by[:3, 2] = by[:, 3] = True
    assert statistics.at_least(by).tolist() == [3, 2, 2, 1]


def test_speeds_are_those_of_the_connected() -> None:
    speed = statistics.speeds(toy_scene(n_frames=4))
    assert speed.shape == (3, 5) and np.allclose(speed, [5, 5, 4, 3, 4])


def test_a_carrier_counts_as_returned_and_what_lies_far_off_does_not() -> None:
    source = ToySource(n_frames=2)
    scene = source.load(source.names()[0])
    ((*sweeps, _),) = source.sweeps(scene, [0])
    rows = np.arange(len(scene.size))
    by = statistics.returned(scene, 0, sweeps, rows)
    assert all(by[k, row] for k, row in enumerate(scene.connected))
    near = [(np.abs(scene.pose[0, :, :2] - sweep.origin[:2]) < statistics.REACH).all(axis=1) for sweep in sweeps]
    assert not (by & ~np.array(near)).any() and by.any(axis=0).sum() > len(scene.connected)


def test_the_program_prints_and_stores_every_split(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(statistics, "open_source", lambda _: ToySource(n_frames=6))
    path = tmp_path / "statistics.json"
    statistics.main(statistics.Args(scenes=("one", "two"), json=path))
    said = json.loads(path.read_text())
    assert set(said) == {"one", "two"} and said["one"] == said["two"]
    one = said["one"]
    assert (one["ego_speed"], one["slowest"], one["fastest"]) == pytest.approx((5.0, 5.0, 5.0), abs=0.01)
    assert one["ego_stands"] == 0 and one["fleet_speed"] == pytest.approx(4.0, abs=0.01)
    assert one["parked"] == pytest.approx(6 / (one["vehicles"]), abs=0.2)
    for shares in (one["returned"], one["found"]):
        assert 1 >= shares[0] >= shares[1] >= shares[2] >= shares[3] >= 0
    assert one["returned"][0] >= 1 - one["hidden"]
    assert "found by" in capsys.readouterr().out
