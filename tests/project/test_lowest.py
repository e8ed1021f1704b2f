"""Every dependency has one lower bound, from which `make lowest` makes an environment."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest

from tests.project.lowest import APART, EXTRAS_APART, lowest

ROOT = Path(__file__).parents[2]
PROJECT: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def test_every_dependency_is_pinned_to_its_bound_but_those_apart() -> None:
    groups = [PROJECT["dependencies"], *PROJECT["optional-dependencies"].values()]
    declared = {requirement.replace(">=", "==") for group in groups for requirement in group}
    apart = {r.partition("==")[0] for r in declared - set(lowest(PROJECT))}
    large = {r.partition(">=")[0] for extra in EXTRAS_APART for r in PROJECT["optional-dependencies"][extra]}
    assert apart <= {*APART, *large} and set(APART) <= apart
    assert set(lowest(PROJECT)) <= declared


def test_the_program_needs_no_package() -> None:
    command = [sys.executable, "-I", str(ROOT / "tests/project/lowest.py")]
    printed = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60).stdout
    assert printed.split() == lowest(PROJECT) and "numpy==1.26" in printed


@pytest.mark.parametrize(
    "requirement", ["numpy", "numpy==1.26", "numpy>=1.26,<3", "numpy>=", "numpy>=1; python_version<'4'"]
)
def test_what_is_no_single_lower_bound_is_refused(requirement: str) -> None:
    with pytest.raises(ValueError, match="a lower bound and no other"):
        lowest({"dependencies": [requirement]})


def test_one_name_has_one_bound() -> None:
    assert lowest({"dependencies": ["a>=1", "torch>=2"], "optional-dependencies": {"x": ["a>=1", "b>=3"]}}) == [
        "a==1",
        "b==3",
    ]
    with pytest.raises(ValueError, match="a has the lower bounds 1 and 2"):
        lowest({"dependencies": ["a>=1"], "optional-dependencies": {"x": ["a>=2"]}})
