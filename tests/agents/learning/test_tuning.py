"""Tuning on toy scenes: a killed study ends as an uninterrupted one, and the best is written as a file."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from agents.learning import training, tuning
from agents.learning.hyperparameters import read_hyperparameters
from agents.learning.training import Recipe
from agents.learning.tuning import MINIBATCHES, Trial, suggest, trial_recipe, tune
from cp_env.world.scene_cache import SceneBank
from tests.agents.conftest import FRAMES

optuna = pytest.importorskip("optuna", reason="pip install 'cp-env[tune]'")

BASE = Recipe(frames=16, worlds=1, every=1, max_frames=FRAMES, n_scenes=2, n_holdout=2, n_steps=8, batch_size=8)
N_STEPS = (4, 8)
Curve = Callable[[Recipe], float]


def search(folder: Path, trials: int, base: Recipe = BASE, seeds: tuple[int, ...] = (0, 1)) -> list[Trial]:
    return list(tune(base, folder, trials=trials, seeds=seeds, n_steps=N_STEPS))


@pytest.fixture
def pretended(monkeypatch: pytest.MonkeyPatch) -> list[Recipe]:
    """Nothing is learned: damage follows from the recipe alone; the list holds what was asked for."""
    asked: list[Recipe] = []

    def train(recipe: Recipe, folder: Path) -> list[dict[str, float]]:
        asked.append(recipe)
        reached = 1 - abs(recipe.gamma - 0.75) - recipe.n_steps / 100 + recipe.seed / 1000
        return [{"frames": 0, "damage": reached - 0.1}, {"frames": 16, "damage": reached}]

    monkeypatch.setattr(tuning, "train", train)
    return asked


def test_a_study_trains_and_writes_what_cp_train_attack_reads(
    bank: SceneBank, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(training, "open_bank", lambda *_: bank)
    first, second = search(tmp_path, 2, seeds=(0,))
    assert first.hyperparameters == BASE.hyperparameters, "the first trial is the recipe's own"
    assert second.hyperparameters != first.hyperparameters
    best = max((first, second), key=lambda trial: trial.score)
    assert read_hyperparameters(tmp_path / "hyperparameters.json") == best.hyperparameters
    for trial in (first, second):
        run = json.loads((tmp_path / f"trial-{trial.number:03}" / "seed-0" / "recipe.json").read_text())
        assert {name: run[name] for name in trial.hyperparameters} == trial.hyperparameters
        curve = json.loads((tmp_path / f"trial-{trial.number:03}" / "seed-0" / "curve.json").read_text())
        assert max(point["damage"] for point in curve) == trial.score
        assert [point["frames"] for point in curve] == [0, 8, 16], "evaluated after the same frames, whatever n_steps"


def test_a_killed_study_ends_as_an_uninterrupted_one(
    pretended: list[Recipe], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = search(tmp_path / "whole", 12)
    n_whole, train = len(pretended), tuning.train

    def killed(recipe: Recipe, folder: Path) -> Any:
        if len(pretended) == n_whole + 9:
            raise KeyboardInterrupt
        return train(recipe, folder)

    with monkeypatch.context() as patch:
        patch.setattr(tuning, "train", killed)
        with pytest.raises(KeyboardInterrupt):
            search(tmp_path / "killed", 12)
    assert search(tmp_path / "killed", 5) == whole[:5]
    assert search(tmp_path / "killed", 12) == whole
    files = [(tmp_path / name / "hyperparameters.json").read_bytes() for name in ("whole", "killed")]
    assert files[0] == files[1]
    count = len(pretended)
    assert search(tmp_path / "whole", 12) == whole and len(pretended) == count, "nothing is played again"


def test_one_killed_before_it_was_known_what_it_would_try_is_drawn_anew(
    pretended: list[Recipe], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def killed(*_: Any) -> dict[str, Any]:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(tuning, "suggest", killed)
        with pytest.raises(KeyboardInterrupt):
            search(tmp_path, 1)
    (first,) = search(tmp_path, 1)
    assert first.hyperparameters == BASE.hyperparameters and [recipe.seed for recipe in pretended] == [0, 1]


def test_the_search_finds_what_is_better(pretended: list[Recipe], tmp_path: Path) -> None:
    trials = search(tmp_path, 25)
    best = max(trials, key=lambda trial: trial.score)
    assert trials[0].score == pytest.approx(0.77 + 0.0005) and best.score > 0.9
    assert best.hyperparameters["n_steps"] == 4 and abs(best.hyperparameters["gamma"] - 0.75) < 0.06
    told = json.loads((tmp_path / "hyperparameters.json").read_text())["about"]
    assert told["trial"] == best.number and told["damage_of_the_recipe"] == list(trials[0].damage)


def test_a_trial_whose_training_breaks_down_is_no_candidate(
    pretended: list[Recipe], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    train = tuning.train

    def diverging(recipe: Recipe, folder: Path) -> Any:
        if recipe.hyperparameters != BASE.hyperparameters:
            raise ValueError("Expected parameter loc to be finite\nand more")
        return train(recipe, folder)

    monkeypatch.setattr(tuning, "train", diverging)
    trials = search(tmp_path, 3)
    assert [trial.reason for trial in trials] == ["", *["Expected parameter loc to be finite"] * 2]
    assert read_hyperparameters(tmp_path / "hyperparameters.json") == BASE.hyperparameters
    with pytest.raises(ValueError, match="own hyperparameters cannot be trained with: Expected parameter loc"):
        search(tmp_path / "other", 3, replace(BASE, gamma=0.8))


def test_a_study_of_something_else_is_refused(pretended: list[Recipe], tmp_path: Path) -> None:
    search(tmp_path, 1)
    with pytest.raises(ValueError, match=r"a study with another defender, seeds of the study; choose another folder"):
        search(tmp_path, 1, replace(BASE, defender="robosac"), seeds=(3,))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"gamma": 0.5}, "tries gamma from 0.6 to 0.99; the recipe has 0.5"),
        ({"batch_size": 7}, "minibatches of 7; choose another n_steps or batch_size"),
        ({"n_steps": 16}, "rollouts of 4, 8 frames"),
        ({"n_steps": 6, "every": 1}, "does not divide into rollouts of 4; choose another `every`"),
    ],
)
def test_what_cannot_be_tried_is_refused(change: dict[str, Any], message: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=message):
        search(tmp_path, 1, replace(BASE, **change))
    for trials, seeds in ((0, (0,)), (1, ()), (1, (2, 2))):
        with pytest.raises(ValueError, match="a study needs a trial and distinct seeds"):
            search(tmp_path, trials, seeds=seeds)


def test_every_draw_makes_a_recipe_of_whole_minibatches() -> None:
    base = Recipe(every=4)
    study = optuna.create_study(sampler=optuna.samplers.RandomSampler(seed=0))
    for _ in range(40):
        values = suggest(study.ask(), base)
        recipe = trial_recipe(base, values, 3)
        steps = recipe.n_steps * recipe.worlds * recipe.n_attackers
        assert steps % recipe.batch_size == 0 and steps // recipe.batch_size in MINIBATCHES
        assert recipe.segment == base.segment and recipe.seed == 3
        assert recipe.hyperparameters == values


def test_without_optuna_the_extra_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "optuna", None)
    with pytest.raises(ImportError, match=r"pip install 'cp-env\[agents,tune\]'"):
        search(tmp_path, 1)
