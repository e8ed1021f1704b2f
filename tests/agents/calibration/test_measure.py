"""A calibration of all parts in one file, which defenders find."""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import defenders
from agents.calibration import Plan, measure
from cp_env.detector import Detector
from cp_env.world.scene_cache import SceneBank
from cp_env.world.world import World
from defenders.calibration import Calibration, read_calibration
from tests.helpers.toy_scenes import ToySource


@pytest.fixture(scope="module")
def measured(
    toy_bank: SceneBank, small: Plan, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Calibration, list[int]]:
    folder, counted = tmp_path_factory.mktemp("calibration"), []

    def count(items: Any, what: str) -> Iterable[Any]:
        del what
        counted.append(len(items))
        return items

    path = folder / f"{toy_bank.detector.digest}.json"
    return measure(toy_bank, small, path, folder=folder / "kept", command="this", track=count), counted


def test_every_part_is_written(measured: tuple[Calibration, list[int]], toy_bank: SceneBank, small: Plan) -> None:
    found, counted = measured
    assert found == read_calibration(found.path) and found.detector == toy_bank.detector.digest
    assert set(found.parts) == {"previous_frame", "ego_agreement", "ego_similarity", "densities"}
    assert counted == list(small.n_episodes.values()) == [3, 3, 5]
    assert all(part["command"] == "this" and "toy, 1 scenes" in part["source"] for part in found.parts.values())


@pytest.mark.parametrize("name", ["prbi:threshold=calibrated", "robosac:threshold=calibrated", "pasac", "bayes"])
def test_a_world_under_the_detector_rests_on_it(
    name: str, measured: tuple[Calibration, list[int]], toy_bank: SceneBank, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By itself, without a word, and whatever the episode: the same thresholds in all worlds."""
    found, _ = measured
    monkeypatch.setenv("CP_ENV_CALIBRATION", str(found.path.parent))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        world = World(2, defender=name, bank=toy_bank, n_vehicles=3, n_attackers=1)
    for defender in world.defenders:
        if name == "bayes":
            assert defender.likelihood.most == 3  # type: ignore[attr-defined]
        else:
            part = {"prbi": "previous_frame", "robosac": "ego_similarity", "pasac": "ego_agreement"}[name.split(":")[0]]
            assert defender.epsilon.epsilon == found.thresholds(part)  # type: ignore[attr-defined]


def test_named_by_its_path(measured: tuple[Calibration, list[int]]) -> None:
    found, _ = measured
    assert defenders.make(f"bayes:likelihood={found.path}").likelihood.most == 3  # type: ignore[attr-defined]


def test_what_cannot_be_measured_is_refused(toy_bank: SceneBank, small: Plan, tmp_path: Path) -> None:
    for wrong, words in (
        ({"stages": ("thresholds",)}, "unknown stage"),
        ({"names": ()}, "at least one scene"),
        ({"previous_frames": 1}, "previous_frames must be at least 2"),
        ({"episodes": replace(small.episodes, frames=2)}, "frames of densities must be at least 3"),
        ({"episodes": replace(small.episodes, n_vehicles=1)}, "n_vehicles must be at least 2"),
    ):
        with pytest.raises(ValueError, match=words):
            replace(small, **wrong)  # type: ignore[arg-type]

    def refused(bank: SceneBank, plan: Plan, words: str) -> None:
        with pytest.raises(ValueError, match=words):
            measure(bank, plan, tmp_path / "c.json", folder=tmp_path, command="", track=lambda jobs, _: jobs)

    refused(toy_bank, replace(small, episodes=replace(small.episodes, n_vehicles=4)), "only 3 connected")
    short = SceneBank(ToySource(n_frames=2, n_connected=3), toy_bank.detector, progress=False)
    refused(short, small, "has 2 frames, and at least 3 are compared")
    blind = SceneBank(ToySource(n_frames=5, n_connected=3), Detector(threshold=1.0).freeze(), progress=False)
    refused(blind, small, "the detector finds nothing .*cp-env evaluate")
    assert not (tmp_path / "c.json").exists()
