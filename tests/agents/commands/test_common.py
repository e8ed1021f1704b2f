"""What the programs share: the victim's name, and errors in one line."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pytest

from agents.commands.common import Victim, run_program
from cp_env.detector import load_detector


@dataclass(frozen=True)
class Args(Victim):
    """Nothing else."""


def test_weights_are_short_for_a_detector(tmp_path: Path) -> None:
    assert Victim().spec == "cp_env" and Victim().open_detector() is load_detector()
    assert Victim(fusion="max").open_detector().digest == load_detector("max").digest
    assert Victim(weights=tmp_path / "mean.safetensors").spec == f"cp_env:weights={tmp_path}/mean.safetensors"
    with pytest.raises(ValueError, match="give one of the two"):
        Victim(detector="mine:Toy", weights=tmp_path / "x").open_detector()
    with pytest.raises(ValueError, match="no weights at"):
        Victim(weights=tmp_path / "nowhere.safetensors").open_detector()


def test_a_program_gets_its_options_and_the_command_as_it_was_typed() -> None:
    told: list[tuple[Args, str]] = []
    run_program("cp-any", Args, lambda *given: told.append(given), "doc", ["--detector", "mine:Toy", "--fusion", "max"])
    ((args, command),) = told
    assert args == Args(detector="mine:Toy", fusion="max") and command == "cp-any --detector mine:Toy --fusion max"


@pytest.mark.parametrize("error", [ValueError("a rule"), ImportError("an extra")])
def test_bad_input_ends_a_program_with_one_line(error: Exception) -> None:
    def body(args: Args, command: str) -> None:
        raise error

    with pytest.raises(SystemExit, match=f"cp-any: {error}"):
        run_program("cp-any", Args, body, None, [])
    with pytest.raises(SystemExit, match="2"):
        run_program("cp-any", Args, body, None, ["--fusion", "median"])
