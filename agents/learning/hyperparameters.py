"""Hyperparameters of PPO: those that fit the environment, the values that are possible, and files that hold them."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cp_env.evaluation.plan.files import write_atomically
from cp_env.scenes.formats.bounded import parse_json, read_bytes
from defenders.registry import shown, unknown

PPO_OPTIONS: dict[str, Any] = {
    "n_steps": 32,
    "batch_size": 128,
    "n_epochs": 8,
    "learning_rate": 1e-3,
    "gamma": 0.9,
    "gae_lambda": 0.9,
    "ent_coef": 0.0,
    "clip_range": 0.2,
}
"""Few and costly frames, returns that hang on the next seconds: short rollouts, a short horizon."""

BOUNDS: dict[str, tuple[float, float]] = {
    "n_steps": (1, 1 << 20),
    "batch_size": (2, 1 << 24),
    "n_epochs": (1, 1000),
    "learning_rate": (0.0, 1.0),
    "gamma": (0.0, 1.0),
    "gae_lambda": (0.0, 1.0),
    "ent_coef": (0.0, 10.0),
    "clip_range": (1e-6, 10.0),
}
"""The smallest and the largest value of each."""

FOLDER = Path(__file__).parent / "tuned"
FORMAT = "cp_env ppo hyperparameters 1"
FILE_BYTES = 1 << 16
"""A file of hyperparameters is at most so long."""


def check_hyperparameters(values: Mapping[str, Any]) -> dict[str, Any]:
    """The values, numbers of the right type.

    Args:
        values: by name; any of `PPO_OPTIONS`, not all of them.

    Raises:
        ValueError: an unknown name, a value of another type, or one outside `BOUNDS`.
    """
    checked: dict[str, Any] = {}
    for name, value in values.items():
        if name not in PPO_OPTIONS:
            raise unknown("hyperparameter", name, tuple(PPO_OPTIONS))
        whole = isinstance(PPO_OPTIONS[name], int)
        if isinstance(value, bool) or not isinstance(value, int if whole else int | float):
            raise ValueError(f"{name} must be {'a whole number' if whole else 'a number'}, not {shown(value)}")
        low, high = BOUNDS[name]
        if not (math.isfinite(value) and low <= value <= high):
            raise ValueError(f"{name} must be {low:g} to {high:g}, not {value}")
        checked[name] = value if whole else float(value)
    return checked


def write_hyperparameters(path: Path, values: Mapping[str, Any], about: Mapping[str, Any]) -> None:
    """Write a file of hyperparameters; it appears whole or not at all.

    Args:
        path: of the file, JSON.
        values: hyperparameters by name.
        about: where they come from, fit for JSON.

    Raises:
        ValueError: values that `check_hyperparameters` refuses, or a file that cannot be written.
    """
    content = {"format": FORMAT, "hyperparameters": check_hyperparameters(values), "about": dict(about)}
    write_atomically(path, json.dumps(content, indent=1) + "\n")


def tuned_names() -> tuple[str, ...]:
    """Names of the hyperparameters that ship with the package: those that `cp-train tune` found."""
    return tuple(sorted(path.stem for path in FOLDER.glob("*.json")))


def read_hyperparameters(path: Path) -> dict[str, Any]:
    """The hyperparameters that a file holds.

    Args:
        path: one of `tuned_names()`; or a file `….json` that `cp-train tune` wrote, or one of yours with the keys
            "format" and "hyperparameters".

    Returns:
        Values by name: all of `PPO_OPTIONS`, or some.

    Raises:
        ValueError: an unknown name, no such file, one of another format, or values that `check_hyperparameters`
            refuses.
    """
    if path.suffix != ".json":
        if str(path) not in tuned_names():
            raise unknown("hyperparameters", str(path), (*tuned_names(), "a file .json"))
        path = FOLDER / f"{path}.json"
    try:
        content = parse_json(read_bytes(path, FILE_BYTES))
    except FileNotFoundError as error:
        raise ValueError(f"no hyperparameters at {path}: the file is missing; write one with cp-train tune") from error
    except (OSError, ValueError) as error:
        raise ValueError(f"cannot read the hyperparameters in {path}: {error}") from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise ValueError(f'{path} holds no hyperparameters: its "format" must be {FORMAT!r}')
    values = content.get("hyperparameters")
    if not isinstance(values, dict):
        raise ValueError(f'{path}: "hyperparameters" must hold names and values, not {shown(values)}')
    try:
        return check_hyperparameters(values)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
