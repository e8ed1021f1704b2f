"""`cp-train`: three kinds; the runs themselves are in test_your_data.py and tests/agents/learning."""

from __future__ import annotations

import json
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest
import tyro

from agents.commands import train_sweep
from agents.commands.train import COMMANDS, main
from agents.learning.training import Recipe

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
        "for kind in ('detector', 'attack', 'sweep'):\n"
        "    try:\n        main([kind, '--help'])\n    except SystemExit as stop:\n        print(kind, stop.code)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert "detector 0" in done.stdout, done.stderr
    assert done.stdout.count("an extra: pip install 'cp-env[agents]'") == 2


@pytest.mark.parametrize("kind", COMMANDS)
def test_every_kind_takes_scenes_and_a_detector_of_your_own(kind: str) -> None:
    words = {
        "attack": ["--scenes", "mine:Folder", "--detector", "mine:Toy"],
        "detector": ["--scenes", "mine:Folder", "--init", "mean"],
        "sweep": ["--recipe.scenes", "mine:Folder", "--recipe.detector", "mine:Toy"],
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
