"""Whatever takes scenes takes V2X-Sim: laws, bank, environments, training, calibration, evaluation, benchmark."""

from __future__ import annotations

import json
import shlex
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import tyro
from numpy.testing import assert_array_equal

import cp_env
from cp_env import evaluation
from cp_env.cli import main
from cp_env.detector import Detector
from cp_env.detector.model.weights import about
from cp_env.detector.training import evaluate, train
from cp_env.detector.training.data import prepare
from cp_env.evaluation.execution.workers import open_bank
from cp_env.scenes import open_source
from cp_env.scenes.export import export
from cp_env.scenes.subset import SceneSubset
from cp_env.testing import check_scenes
from cp_env.world.scene_cache import SceneBank
from cp_env.world.world import World
from tests.helpers.coperception_files import write_files
from tests.helpers.toy_scenes import ToySource
from tests.helpers.v2xsim_sets import Numbered

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
    before = SceneBank(TOY, detector, tmp_path, progress=False)
    assert bank.root != before.root
    original = before.episode("toy-0", 3, rsu=True)
    assert_array_equal(episode.ego_T_sender, original.ego_T_sender)
    for t in range(original.scene.n_frames):
        ours, theirs = (one.maps("features", t) for one in (episode, original))
        assert float((ours != theirs).float().mean()) < 0.02  # a point on a cell's edge may round to the other side
    assert any(bank.root.glob("toy-0/*.maps"))
    for truth, expected in zip(episode.truth, original.truth, strict=True):
        np.testing.assert_allclose(truth, expected, atol=1e-3)


@pytest.mark.parametrize("kind", ["raw", "det"])
def test_environments_play_in_it(spec: str, det: str, kind: str) -> None:
    scenes = spec if kind == "raw" else det
    options = {"n_vehicles": 3, "n_attackers": 1, "action": "basis", "max_frames": 2}
    env = cp_env.parallel_env("ego_only", scenes=scenes, rsu=True, **options)
    env.reset(seed=0)
    *_, infos = env.step({agent: env.action_space(agent).sample() for agent in env.agents})
    assert all(np.isfinite(info["damage"]) for info in infos.values())
    envs = cp_env.vector_env(2, "ego_only", scenes=open_source(scenes), **options)
    envs.reset(seed=0)
    envs.step(envs.action_space.sample())
    with pytest.raises(ValueError, match="holds only 3 connected vehicles"):
        cp_env.parallel_env("ego_only", scenes=scenes, n_vehicles=5)


def documented() -> list[list[str]]:
    """The words of each command of the paper's setting, as the page has them."""
    page = (Path(__file__).parents[4] / "docs/v2x-sim.md").read_text()
    block = page.partition("```sh\nDATA=")[2].partition("```")[0].replace("\\\n", " ")
    variables, _, commands = f"DATA={block}".partition(";")
    for name, _, value in (variable.partition("=") for variable in shlex.split(variables)):
        commands = commands.replace(f"${name}", value)
    return [shlex.split(command) for command in commands.split("&&")]


def split(command: list[str]) -> tuple[str, list[str]]:
    """The program, its subcommand included, and its options."""
    first = next(number for number, word in enumerate(command) if word.startswith("--"))
    return " ".join(command[:first]), command[first:]


def test_the_papers_setting_by_the_documented_commands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Train on one scene, calibrate on the second, measure on the third; the official splits say which is which."""
    root, weights = export(Numbered(n_frames=2), tmp_path / "set"), tmp_path / "mean.safetensors"
    monkeypatch.setattr(sys, "argv", ["benchmark.py"])
    from examples import benchmark

    programs, (words, more, rest) = zip(*map(split, documented()), strict=True)
    assert programs == ("cp-train detector", "cp-env evaluate", "cp-benchmark")
    words, more, rest = (
        [word.replace("/data/V2X-Sim-2.0", str(root)) for word in part] for part in (words, more, rest)
    )
    learn = tyro.cli(train.Args, args=words)
    small = {"frames": 1, "egos": 1, "views": 2, "steps": 1, "threads": 1, "init": Path("mean"), "learning_rate": 1e-6}
    train.main(replace(learn, out=tmp_path, cache=tmp_path / "cache", **small))  # type: ignore[arg-type]
    assert about(weights)["trained"]["source"] == open_source(learn.scenes).digest
    calibrate = tyro.cli(evaluate.Args, args=more)
    assert open_source(learn.scenes).names() == ("scene_0",) and open_source(calibrate.scenes).names() == ("scene_1",)
    evaluate.main(replace(calibrate, weights=weights))
    assert about(weights)["calibrated"] == calibrate.scenes
    play = tyro.cli(benchmark.Args, args=rest)
    assert (play.vehicles, play.frames, play.ks, play.protocol) == (5, 100, (1, 2, 3, 4), "coperception")
    few = {"frames": 2, "defenders": ("prbi",), "attacks": ("pgd:steps=1",), "ks": (2,), "gif": False}
    benchmark.main(replace(play, weights=str(weights), out=tmp_path / "out", **few))  # type: ignore[arg-type]
    assert "scene_5" in json.dumps(json.loads((tmp_path / "out" / "results.json").read_text()))
    with pytest.raises(ValueError, match="fuse by mean; choose that fusion, not max"):
        open_bank(evaluation.Conditions(play.scenes, ("scene_5",), fusion="max", weights=str(weights)))


def test_the_benchmark_takes_a_path_or_a_source(spec: str) -> None:
    source = open_source(spec)
    for scenes in (spec, source, SceneSubset(spec, 1)):
        conditions = evaluation.Conditions(scenes=scenes, names=source.names()[:1], frames=2, n_vehicles=3)
        assert open_bank(conditions).source.digest == source.digest
        (cell,) = evaluation.plan_runs(conditions, defenders=["none"], attacks=["none"], ks=[1], seeds=[0])
        assert cell.slug(conditions) and World(1, defender="none", scenes=scenes, n_vehicles=3, n_attackers=1)
    with pytest.raises(ValueError, match="unknown scenes"):
        evaluation.Conditions(scenes=spec, names=("toy-9",))


def test_a_source_that_counts_no_returns_can_be_trained_on(tmp_path: Path) -> None:
    def silent(scene: object, frames: object) -> object:
        return [[replace(sweep, hits=None) for sweep in row] for row in TOY.sweeps(scene, frames)]  # type: ignore[arg-type]

    source = SimpleNamespace(name="silent", digest="silent", names=TOY.names, load=TOY.load, sweeps=silent)
    told, counted = prepare(TOY, tmp_path, limit=1)[0].hits, prepare(source, tmp_path, limit=1)[0].hits
    assert ((told >= 3) == (counted >= 3)).mean() > 0.97


def test_export_by_command(tmp_path: Path, spec: str, capsys: pytest.CaptureFixture[str]) -> None:
    main(["scenes", "export", "--source", spec, "--out", str(tmp_path / "new"), "--frames", "1", "--names", "toy-1"])
    assert "written in the layout of v2x-sim" in " ".join(capsys.readouterr().out.split())
    (name,) = open_source(f"v2x-sim:{tmp_path / 'new'}").names()
    assert name == "toy-1"
    with pytest.raises(SystemExit, match="is not empty"):
        main(["scenes-export", "--source", spec, "--out", str(tmp_path / "new")])
