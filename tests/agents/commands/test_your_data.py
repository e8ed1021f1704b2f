"""docs/your-data.md from end to end, on a miniature: every command of the page, with fewer frames and steps."""

from __future__ import annotations

import json
import shutil
import sys
import warnings
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from agents.arena import cli as arena
from agents.commands import benchmark, calibrate, play, train
from cp_env import cli
from cp_env.detector.model.weights import read_detector
from defenders.calibration import read_calibration
from examples.bring_your_own_scenes import write_miniature
from tests.helpers.pages import blocks, commands

PAGE = "docs/your-data.md"
PROGRAMS: dict[str, Callable[[list[str]], None]] = {
    "cp-arena": arena.main,
    "cp-benchmark": benchmark.main,
    "cp-calibrate": calibrate.main,
    "cp-env": cli.main,
    "cp-play": play.main,
    "cp-train": train.main,
}
SMALL = {
    "cp-env scenes preview": "--every 2 --extent 20",
    "cp-train detector": "--steps 1 --frames 1 --egos 1 --views 2 --agents 3 --stride 2 --cache cache",
    "cp-env evaluate": "--n-vehicles 3 --frames 2",
    "cp-calibrate": "--vehicles 3 --previous-frames 2 --ego-frames 1 --frames 3 --ages 1 --attack noise "
    "--stealthy noise:every=2",
    "cp-benchmark": "--vehicles 3 --frames 2 --ks 1 --attacks none noise",
    "cp-arena": "--vehicles 3 --frames 2 --ks 1 --attacks none noise --workers 1 --no-videos",
    "cp-train attack": "--n-scenes 1 --n-holdout 1 --n-vehicles 3 --n-attackers 1 --max-frames 2 --worlds 1 "
    "--frames 2 --every 1 --n-steps 2 --batch-size 2 --n-epochs 1",
    "cp-play": "--n-scenes 1 --vehicles 3 --k 1 --frames 2 --attacks noise",
}
"""Options that make each command small; they come last, and the last one counts."""


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six frames of three vehicles of the town, as if they had been recorded, three times."""
    folder = tmp_path_factory.mktemp("data")
    write_miniature(folder / "data/train", vehicles=3, frames=6)
    for split in ("calibration", "test"):
        shutil.copytree(folder / "data/train", folder / "data" / split)
    _, code = next(blocks(PAGE, "python"))
    (folder / "mine.py").write_text(code)
    return folder


def test_from_data_to_a_table(data: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """In order, each from what the ones before have written; no defender rests on other weights at the end."""
    monkeypatch.chdir(data)
    monkeypatch.setenv("CP_ENV_CALIBRATION", str(data / "calibrations"))
    monkeypatch.delitem(sys.modules, "mine", raising=False)
    threads, given = torch.get_num_threads(), set()
    for words in commands(PAGE):
        if words[:3] == ["cp-env", "scenes", "export"] or words[0] not in PROGRAMS:
            continue  # instead of data of one's own
        name = next((name for name in SMALL if words[: len(name.split())] == name.split()), words[0])
        given.add(name)
        with warnings.catch_warnings():
            warnings.simplefilter("error", UserWarning)
            PROGRAMS[words[0]]([*words[1:], *SMALL.get(name, "").split()])
    torch.set_num_threads(threads)
    assert given >= set(SMALL), "the page names every program"
    weights = read_detector(Path("runs/mine/mean.safetensors"))
    (calibration,) = Path("calibrations").iterdir()
    assert calibration.stem == weights.freeze().digest
    assert set(read_calibration(calibration).parts) == {
        "previous_frame",
        "ego_agreement",
        "ego_similarity",
        "densities",
    }
    results = json.loads(Path("out/mine/results.json").read_text())
    assert "bayes" in json.dumps(results) and Path("out/arena/arena.html").exists()
    assert "Against bayes" in Path("runs/play/attacks.md").read_text()
    assert "the policy: runs/attack/policy.safetensors" in capsys.readouterr().out
