"""The recording program: streets, traffic, parked rows and the selection of vehicles, by hand and on fresh networks."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from cp_env.scenes import FAMILIES, KINDS, SPLITS, Town
from cp_env.scenes.formats import recording
from cp_env.scenes.sumo import build, network, traffic
from cp_env.scenes.sumo.record import COUNTS, Args, main, plan
from cp_env.scenes.sumo.regimes import REGIMES
from tests.helpers.toy_traffic import town_without_streets


@pytest.mark.parametrize(("regime", "kinds"), [("town", KINDS), ("junction", ("junction",))])
def test_plan_names_every_scene_once(regime: str, kinds: tuple[str, ...]) -> None:
    names = plan(regime, (2, 1, 1))
    assert list(names) == list(SPLITS) and len(names["train"]) == 2 * len(kinds)
    assert len({name for split in names.values() for name in split}) == 4 * len(kinds)
    assert {name.split("-")[1] for name in names["train"]} == set(kinds) <= set(REGIMES)


def test_what_ships_is_what_the_program_plans() -> None:
    for regime, family in FAMILIES.items():
        assert plan(regime, COUNTS[regime]) == {split: list(family(split).names()) for split in SPLITS}


@pytest.mark.usefixtures("simulator")
def test_the_same_seed_records_the_same_file_and_another_seed_another(tmp_path: Path) -> None:
    name = "test-intersection-00"
    for k in range(2):
        recording.write(tmp_path / f"{k}.npz", build.record(name, REGIMES["intersection"], "flows", seed=5))
    assert (tmp_path / "0.npz").read_bytes() == (tmp_path / "1.npz").read_bytes()
    other = Town("test").load(name)  # of another seed
    assert recording.read(tmp_path / "0.npz", name).obstacles.tolist() != other.obstacles.tolist()


@pytest.mark.usefixtures("simulator")
def test_a_killed_run_goes_on(tmp_path: Path) -> None:
    town = Town("test")
    scene = town.load(town.names()[0])
    names = plan("town", (1, 0, 0))["train"]
    for name in names:
        recording.write(tmp_path / f"{name}.npz", scene)
    before = {path.name: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    main(Args(out=tmp_path, train=1, calibration=0, test=0))
    assert {name: (tmp_path / name).stat().st_mtime_ns for name in before} == before, "nothing was recorded again"
    assert Town("train", tmp_path).names() == tuple(names)


def test_without_sumo_the_way_out_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "sumo", None)
    monkeypatch.setitem(sys.modules, "libsumo", None)
    rng = np.random.default_rng(0)
    with pytest.raises(ImportError, match=r"\[sumo\]"):
        network.build_streets(*network.draw_streets("urban", rng), tmp_path)
    with pytest.raises(ImportError, match=r"\[sumo\]"):
        traffic.drive(town_without_streets(10), tmp_path, rng, crowd=3)
