"""Files of hyperparameters: what is written comes back, and nothing else is taken."""

from __future__ import annotations

import json
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agents.learning.hyperparameters import (
    BOUNDS,
    FOLDER,
    FORMAT,
    PPO_OPTIONS,
    check_hyperparameters,
    read_hyperparameters,
    tuned_names,
    write_hyperparameters,
)
from agents.learning.training import Recipe


def test_what_is_written_comes_back(tmp_path: Path) -> None:
    values = PPO_OPTIONS | {"gamma": 0.75, "n_steps": 16}
    write_hyperparameters(tmp_path / "found" / "h.json", values, {"trial": 3})
    assert read_hyperparameters(tmp_path / "found" / "h.json") == values
    assert json.loads((tmp_path / "found" / "h.json").read_text())["about"] == {"trial": 3}


@pytest.mark.parametrize("name", tuned_names())
def test_what_ships_was_tuned_against_what_its_name_says(name: str) -> None:
    """All values are there, and the recipe that they were tuned for can still be made, and was not better off."""
    assert read_hyperparameters(Path(name)).keys() == PPO_OPTIONS.keys()
    about = json.loads((FOLDER / f"{name}.json").read_text())["about"]
    recipe = Recipe(**about["recipe"])
    assert name.startswith(recipe.defender) and name.endswith(f"{recipe.action}-action")
    assert np.mean(about["damage_held_back"]) >= np.mean(about["damage_of_the_recipe"])
    assert "calibration" in recipe.holdout and "train" in recipe.scenes


def test_a_name_that_does_not_ship_is_refused_with_those_that_do() -> None:
    assert tuned_names()
    with pytest.raises(ValueError, match=f"unknown hyperparameters 'nobody'.*{tuned_names()[0]}.*a file .json"):
        read_hyperparameters(Path("nobody"))


def test_every_hyperparameter_has_bounds_and_a_place_in_the_recipe() -> None:
    defaults = {field.name: field.default for field in fields(Recipe)}
    assert BOUNDS.keys() == PPO_OPTIONS.keys()
    assert {name: defaults[name] for name in PPO_OPTIONS} == PPO_OPTIONS == Recipe().hyperparameters
    assert check_hyperparameters({"gamma": 1}) == {"gamma": 1.0}
    assert type(check_hyperparameters({"gamma": 1})["gamma"]) is float


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"gama": 0.9}, "unknown hyperparameter 'gama' .did you mean 'gamma'"),
        ({"gamma": 1.1}, "gamma must be 0 to 1, not 1.1"),
        ({"gamma": float("nan")}, "gamma must be 0 to 1, not nan"),
        ({"gamma": "0.9"}, "gamma must be a number, not '0.9'"),
        ({"n_steps": 16.0}, "n_steps must be a whole number, not 16.0"),
        ({"n_epochs": True}, "n_epochs must be a whole number, not True"),
        ({"batch_size": 1}, "batch_size must be 2 to"),
    ],
)
def test_bad_values_are_refused(values: dict[str, Any], message: str, tmp_path: Path) -> None:
    path = tmp_path / "h.json"
    with pytest.raises(ValueError, match=message):
        write_hyperparameters(path, values, {})
    assert not path.exists()
    path.write_text(json.dumps({"format": FORMAT, "hyperparameters": values}).replace("NaN", "7.5"))
    with pytest.raises(ValueError, match=f"h.json: {next(iter(values))}|h.json: unknown"):
        read_hyperparameters(path)
    if values in ({"gamma": 1.1}, {"batch_size": 1}):
        with pytest.raises(ValueError, match=message):
            Recipe(**values)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "the file is missing; write one with cp-train tune"),
        ("{", "cannot read the hyperparameters"),
        ("[]", '"format" must be'),
        ('{"format": "other"}', '"format" must be'),
        (json.dumps({"format": FORMAT, "hyperparameters": [1]}), "must hold names and values"),
        ("[" * 1000, "cannot read the hyperparameters"),
        (" " * (1 << 17), "cannot read the hyperparameters"),
    ],
)
def test_what_is_no_such_file_is_refused(text: str | None, message: str, tmp_path: Path) -> None:
    if text is not None:
        (tmp_path / "h.json").write_text(text)
    with pytest.raises(ValueError, match=message):
        read_hyperparameters(tmp_path / "h.json")
