"""Learning curves of invented runs: what is compared, what is written, what is drawn; nothing is learned here."""

from __future__ import annotations

import json
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from agents.learning.rollout import Episodes
from agents.learning.sweep import TrainingRun, plan_sweep
from cp_env.world.scene_cache import SceneBank
from examples.reproduce import learning_curves as program
from tests.helpers.toy_evaluation import toy_bank

BOTH = ("guided", "stealth:action=stealth")
FOUND: program.Baselines = {
    "random": {"damage": [0.2, 0.3], "excluded": [0.1, 0.2]},
    "pgd": {"damage": [0.25, 0.35], "excluded": [1.0, 0.9]},
}


def invented(args: program.Args, points: dict[int, int]) -> list[TrainingRun]:
    """Runs whose damage is 0.1 a point, and 0.01 a seed; `points` says how many each seed has reached."""
    runs = plan_sweep(
        args.recipe, defenders=["prbi"], configurations=args.configurations, seeds=args.seeds, root=args.out
    )
    for run in runs:
        seed = run.recipe.seed
        curve = [{"frames": 512.0 * p, "damage": 0.1 * p + 0.01 * seed, "excluded": 0.5} for p in range(points[seed])]
        run.folder.mkdir(parents=True)
        (run.folder / "curve.json").write_text(json.dumps(curve))
    return runs


def test_the_table_has_mean_and_range_over_seeds_and_the_baselines(tmp_path: Path) -> None:
    args = program.Args(out=tmp_path, seeds=(0, 2), configurations=BOTH)
    text = program.write(invented(args, {0: 3, 2: 4}), FOUND, args)
    assert "| attack | 0 frames | 512 frames | 1024 frames |" in text, "points that all runs have reached"
    assert text.count("| 0.010 (0.000 to 0.020) | 0.110 (0.100 to 0.120) | 0.210 (0.200 to 0.220) |") == 2
    assert "| random | 0.250 [" in text and "over 2 seeds" in text
    data = json.loads((tmp_path / "curves.json").read_text())
    assert [(run["configuration"], run["seed"]) for run in data["curves"]] == [
        ("guided", 0),
        ("stealth", 0),
        ("guided", 2),
        ("stealth", 2),
    ]
    assert data["baselines"] == FOUND


def test_a_picture_is_drawn(tmp_path: Path) -> None:
    args = program.Args(out=tmp_path, configurations=BOTH)
    program.draw(invented(args, {0: 2, 1: 2, 2: 2}), FOUND, args)
    with Image.open(tmp_path / "curves.png") as drawn:
        assert drawn.width > 1000


def test_baselines_meet_the_scenes_held_back_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    met: list[tuple[str, tuple[str, ...], int]] = []

    def play(attack: Any, conditions: Any, bank: SceneBank, *, defender: str, k: int) -> Episodes:
        met.append((type(attack).__name__, conditions.names, conditions.frames))
        assert (defender, k) == ("prbi", 2) and bank is toy_bank()
        return Episodes(*(np.array([0.5, 0.25]) for _ in fields(Episodes)))

    monkeypatch.setattr("agents.learning.training.open_bank", lambda *_: toy_bank())
    monkeypatch.setattr(program, "play", play)
    args = program.Args(out=tmp_path)
    found = program.baselines(args)
    assert found == {name: {"damage": [0.5, 0.25], "excluded": [0.5, 0.25]} for name in ("random", "pgd")}
    assert [names for _, names, _ in met] == [("toy-0", "toy-1")] * 2 and met[0][0] == "RandomActions"
    assert program.baselines(args) == found and len(met) == 2, "they are kept"
    program.baselines(replace(args, recipe=replace(args.recipe, max_frames=7)))
    assert met[-1][2] == 7, "and played anew under other conditions"


def test_no_more_configurations_than_colours(tmp_path: Path) -> None:
    args = program.Args(out=tmp_path, configurations=tuple("abcde"))
    with pytest.raises(SystemExit, match="at most 4 configurations"):
        program.main(args)
