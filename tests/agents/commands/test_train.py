"""`cp-train`: three kinds; the runs themselves are in test_your_data.py and tests/agents/learning."""

from __future__ import annotations

import json
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest
import tyro

from agents.commands import train_attack, train_sweep, train_tune
from agents.commands.train import COMMANDS, main
from agents.learning.hyperparameters import write_hyperparameters
from agents.learning.training import Recipe
from agents.learning.tuning import Trial
from cp_env.settings import REWARDS

ROOT = Path(__file__).parents[3]


def test_help_names_every_kind(capsys: pytest.CaptureFixture[str]) -> None:
    for words in ([], ["--help"]):
        main(words)
        told = capsys.readouterr().out
        assert all(f"cp-train {kind}" in told for kind in COMMANDS)
    for kind in COMMANDS:
        with pytest.raises(SystemExit, match="0"):
            main([kind, "--help"])
        assert f"usage: cp-train {kind}" in capsys.readouterr().out


def test_bad_input_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match=r"cp-train: unknown command 'atack' .did you mean 'attack'"):
        main(["atack"])
    with pytest.raises(SystemExit, match="2"):
        main(["attack", "--defender", "prib", "--out", str(tmp_path)])
    assert "unknown defender 'prib'" in capsys.readouterr().err
    with pytest.raises(SystemExit, match=r"cp-train detector: unknown scenes 'village'"):
        main(["detector", "--scenes", "village", "--out", str(tmp_path)])


def test_a_detector_is_trained_without_stable_baselines() -> None:
    """The others say which extra they need."""
    code = (
        "import sys\nsys.modules['stable_baselines3'] = None\nfrom agents.commands.train import main\n"
        "for kind in ('detector', 'attack', 'sweep', 'tune'):\n"
        "    try:\n        main([kind, '--help'])\n    except SystemExit as stop:\n        print(kind, stop.code)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert "detector 0" in done.stdout, done.stderr
    assert done.stdout.count("an extra: pip install 'cp-env[agents]'") == 3


@pytest.mark.parametrize("kind", COMMANDS)
def test_every_kind_takes_scenes_and_a_detector_of_your_own(kind: str) -> None:
    words = {
        "attack": ["--scenes", "mine:Folder", "--detector", "mine:Toy"],
        "detector": ["--scenes", "mine:Folder", "--init", "mean"],
        "sweep": ["--recipe.scenes", "mine:Folder", "--recipe.detector", "mine:Toy"],
        "tune": ["--recipe.scenes", "mine:Folder", "--recipe.detector", "mine:Toy"],
    }
    args = tyro.cli(import_module(COMMANDS[kind]).Args, args=words[kind])
    found = args if kind == "detector" else args.recipe
    assert found.scenes == "mine:Folder" and getattr(found, "detector", "mine:Toy") == "mine:Toy"


def test_a_sweep_encodes_under_its_own_detector_and_writes_its_table(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The learning itself is replaced: what is claimed is which bank is opened, and what is written."""
    opened: list[tuple[object, ...]] = []

    class Bank:
        source = type("Source", (), {"names": staticmethod(tuple)})

    def learned(runs: list[train_sweep.TrainingRun], workers: int) -> list[int]:
        assert workers == 1
        for run in runs:
            run.folder.mkdir(parents=True)
            curve = [{"frames": 8, "damage": 0.1 * (1 + run.recipe.seed), "excluded": 0.5}]
            (run.folder / "curve.json").write_text(json.dumps(curve))
            (run.folder / "policy.safetensors").write_bytes(b"policy")
        return [8 * len(runs)]

    monkeypatch.setattr(train_sweep, "open_bank", lambda *words: opened.append(words) or Bank)
    monkeypatch.setattr(train_sweep, "sweep", learned)
    recipe = Recipe(frames=8, worlds=1, every=1, detector="mine:Toy", fusion="max")
    args = train_sweep.Args(
        defenders=["prbi"], configurations=["shared"], recipe=recipe, workers=1, out=tmp_path, seeds=[0, 1]
    )
    table, kept = train_sweep.report(train_sweep.learn(args), args)
    assert {words[2:] for words in opened} == {("mine:Toy", "max")} and len(opened) == 2
    assert "| prbi | shared (kept) | 2 |" in table and kept == [tmp_path / "strongest" / "prbi.safetensors"]
    assert json.loads((tmp_path / "sweep.json").read_text())


def test_the_help_names_every_reward(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="0"):
        main(["attack", "--help"])
    assert f"{{{','.join(REWARDS)}}}" in "".join(capsys.readouterr().out.split())


def test_hyperparameters_of_a_file_take_the_place_of_the_defaults(tmp_path: Path) -> None:
    path = tmp_path / "found.json"
    write_hyperparameters(path, {"gamma": 0.8, "n_steps": 16}, {})
    args = train_attack.Args(recipe=Recipe(seed=3, gamma=0.8), hyperparameters=path)
    assert args.settled() == Recipe(seed=3, gamma=0.8, n_steps=16)
    assert train_attack.Args(recipe=Recipe(seed=3)).settled() == Recipe(seed=3)
    with pytest.raises(SystemExit, match=r"cp-train attack: gamma is 0.7 here and 0.8 in .*found.json; give it once"):
        main(["attack", "--gamma", "0.7", "--hyperparameters", str(path), "--out", str(tmp_path / "run")])
    with pytest.raises(SystemExit, match=r"cp-train attack: no hyperparameters at .*the file is missing"):
        main(["attack", "--hyperparameters", str(tmp_path / "none.json"), "--out", str(tmp_path / "run")])
    assert not (tmp_path / "run").exists()


def test_tuning_says_its_plan_and_what_was_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The search itself is in tests/agents/learning/test_tuning.py."""
    trials = [Trial(0, {"gamma": 0.9}, (0.25, 0.35)), Trial(1, {"gamma": 0.8}, (0.5, 0.7)), Trial(2, {}, (), "why")]
    asked: list[tuple[object, ...]] = []

    def tune(base: Recipe, folder: Path, *, trials: int, seeds: tuple[int, ...], seed: int) -> list[Trial]:
        asked.append((base.defender, folder, trials, tuple(seeds), seed))
        folder.mkdir()
        return found

    found = trials
    monkeypatch.setattr(train_tune, "tune", tune)
    out = tmp_path / "tune"
    main(["tune", "--trials", "3", "--seeds", "0", "4", "--recipe.defender", "robosac", "--out", str(out)])
    said = capsys.readouterr()
    assert asked == [("robosac", out, 3, (0, 4), 0)]
    assert "plan: 3 trials of 2 policies, 12288 frames in all, compared on 6 scenes of town/calibration" in said.err
    assert "0.600 in trial 1, 0.300 with the recipe's own values; the best of 3 is biased upwards" in said.out
    written = json.loads((out / "trials.json").read_text())
    assert [trial["reason"] for trial in written["trials"]] == ["", "", "why"] and "cp-train tune" in written["command"]
