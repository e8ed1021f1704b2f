"""Whatever takes scenes takes V2X-Sim: laws, bank, environments, training, calibration, evaluation, benchmark."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import cp_env
from agents.scenes import Some
from cp_env import evaluation
from cp_env.bank import SceneBank
from cp_env.cli import main
from cp_env.detector import Detector, evaluate, train
from cp_env.detector.data import prepare
from cp_env.detector.weights import about, read_detector
from cp_env.evaluation.runner import open_bank
from cp_env.scenes import open_source
from cp_env.scenes.export import export
from cp_env.scenes.hits import CLEARANCE, MARGIN, count_returns
from cp_env.testing import check_scenes
from cp_env.world import World
from tests.reference.coperception_files import write_files
from tests.toy import ToySource

TOY = ToySource(n_frames=2, n_connected=3)


@pytest.fixture(scope="module")
def spec(tmp_path_factory: pytest.TempPathFactory) -> str:
    return f"v2x-sim:{export(TOY, tmp_path_factory.mktemp('use') / 'set')}?progress=no"


@pytest.fixture(scope="module")
def det(tmp_path_factory: pytest.TempPathFactory) -> str:
    root = tmp_path_factory.mktemp("use") / "det"
    write_files(TOY, root, "train", {"toy-0": 0, "toy-1": 2})
    return f"v2x-sim-det:{root}?progress=no"


def test_the_raw_set_keeps_the_laws_of_scenes(spec: str) -> None:
    assert len(check_scenes(spec)) > 10


def test_the_detection_files_keep_the_laws_of_scenes(det: str) -> None:
    assert len(check_scenes(det)) > 10


def test_maps_are_cached_under_the_sets_digest(spec: str, tmp_path: Path) -> None:
    source, detector = open_source(spec), Detector().freeze()
    bank = SceneBank(source, detector, tmp_path, progress=False)
    episode = bank.episode("toy-0", 3, rsu=True)
    assert (tmp_path / f"{source.digest}-{detector.digest}" / "toy-0").is_dir()
    original = SceneBank(TOY, detector, tmp_path, progress=False).episode("toy-0", 3, rsu=True)
    assert_array_equal(episode.ego_T_sender, original.ego_T_sender)
    different = [np.mean(a != b) for a, b in zip(episode.features, original.features, strict=True)]
    assert max(different) < 0.02  # a point on the edge of a cell may round to the other side
    for truth, expected in zip(episode.truth, original.truth, strict=True):
        np.testing.assert_allclose(truth, expected, atol=1e-3)


@pytest.mark.parametrize("kind", ["raw", "det"])
def test_environments_play_in_it(spec: str, det: str, kind: str) -> None:
    scenes = spec if kind == "raw" else det
    knobs = {"n_vehicles": 3, "n_attackers": 1, "action": "basis", "max_frames": 2}
    env = cp_env.parallel_env("ego_only", scenes=scenes, rsu=True, **knobs)
    env.reset(seed=0)
    *_, infos = env.step({agent: env.action_space(agent).sample() for agent in env.agents})
    assert all(np.isfinite(info["damage"]) for info in infos.values())
    envs = cp_env.vector_env(2, "ego_only", scenes=open_source(scenes), **knobs)
    envs.reset(seed=0)
    envs.step(envs.action_space.sample())
    with pytest.raises(ValueError, match="holds only 3 connected vehicles"):
        cp_env.parallel_env("ego_only", scenes=scenes, n_vehicles=5).reset(seed=0)


def test_train_calibrate_and_evaluate_by_the_same_commands(spec: str, tmp_path: Path) -> None:
    small = {"frames": 1, "egos": 1, "views": 2, "agents": 3, "steps": 1, "threads": 1}
    train.main(train.Args(scenes=spec, out=tmp_path, cache=tmp_path / "cache", **small))  # type: ignore[arg-type]
    weights = tmp_path / "mean.safetensors"
    assert about(weights)["trained"]["source"] == open_source(spec).digest
    args = evaluate.Args(scenes=spec, weights=weights, n_vehicles=2, frames=2, json=tmp_path / "figures.json")
    evaluate.main(replace(args, calibrate=True))
    assert about(weights)["calibrated"] == spec
    assert json.loads((tmp_path / "figures.json").read_text())["threshold"] == read_detector(weights).threshold
    evaluate.main(replace(args, limit=1))
    assert json.loads((tmp_path / "figures.json").read_text())["n_frames"] == 2


def test_the_benchmark_takes_a_path_or_a_source(spec: str) -> None:
    source = open_source(spec)
    for scenes in (spec, source, Some(spec, 1)):
        protocol = evaluation.Protocol(scenes=scenes, names=source.names()[:1], frames=2, n_vehicles=3)
        assert open_bank(protocol).source.digest == source.digest
        (cell,) = evaluation.plan(protocol, defenders=["none"], attacks=["none"], ks=[1], seeds=[0])
        assert cell.slug(protocol) and World(1, defender="none", scenes=scenes, n_vehicles=3, n_attackers=1)
    with pytest.raises(ValueError, match="unknown scenes"):
        evaluation.Protocol(scenes=spec, names=("toy-9",))


def test_a_source_that_counts_no_returns_can_be_trained_on(tmp_path: Path) -> None:
    def silent(scene: object, frames: object) -> object:
        return [[replace(sweep, hits=None) for sweep in row] for row in TOY.sweeps(scene, frames)]  # type: ignore[arg-type]

    source = SimpleNamespace(name="silent", digest="silent", names=TOY.names, load=TOY.load, sweeps=silent)
    told, counted = prepare(TOY, tmp_path, limit=1)[0].hits, prepare(source, tmp_path, limit=1)[0].hits
    assert ((told >= 3) == (counted >= 3)).mean() > 0.97


def test_returns_in_boxes_against_a_loop() -> None:
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-30, 30, (3000, 2)), rng.uniform(0, 3, 3000)])
    centre = np.column_stack([rng.uniform(-50, 50, (60, 2)), rng.uniform(0.5, 1.5, 60)])
    size, yaw = rng.uniform(1, 12, (60, 3)), rng.uniform(-4, 4, 60)
    centre[3] = np.nan
    hits = count_returns(points, centre, size, yaw)
    for k in range(60):
        turn = np.array([[np.cos(yaw[k]), -np.sin(yaw[k])], [np.sin(yaw[k]), np.cos(yaw[k])]])
        own = np.column_stack([(points - centre[k])[:, :2] @ turn, points[:, 2] - centre[k, 2]])
        inside = (np.abs(own) <= size[k] / 2 + MARGIN).all(axis=1) & (own[:, 2] >= CLEARANCE - size[k, 2] / 2)
        assert hits[k] == inside.sum()
    assert hits.sum() > 100 and count_returns(points[:0], centre, size, yaw).tolist() == [0] * 60
    assert count_returns(points, centre + 1000, size, yaw).sum() == 0


def test_export_by_command(tmp_path: Path, spec: str, capsys: pytest.CaptureFixture[str]) -> None:
    main(["scenes", "export", "--source", spec, "--out", str(tmp_path / "new"), "--frames", "1", "--names", "toy-1"])
    assert "written in the layout of v2x-sim" in " ".join(capsys.readouterr().out.split())
    (name,) = open_source(f"v2x-sim:{tmp_path / 'new'}").names()
    assert name == "toy-1"
    with pytest.raises(SystemExit, match="is not empty"):
        main(["scenes-export", "--source", spec, "--out", str(tmp_path / "new")])
