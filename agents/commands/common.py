"""What the programs share: options that name the victim, and how a program begins and ends."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import torch
import tyro

from cp_env.detector.protocol import DetectorLike
from cp_env.detector.registry import open_detector, precise
from cp_env.evaluation import FailedRuns
from cp_env.paths import use_current_folder
from cp_env.settings import Fusion, Precision
from cp_env.world.allocator import keep_freed_memory

A = TypeVar("A")


@dataclass(frozen=True)
class Victim:
    """The attacked detector."""

    detector: str = "cp_env"
    """our own; coperception:checkpoint=FILE; or module:Class of yours"""
    weights: Path | None = None
    """a file that `cp-train detector` writes; else those that ship"""
    fusion: Fusion = "mean"
    """how maps are fused, of a detector that leaves it open"""
    precision: Precision = "float32"
    """of the detector's maps, fusion and decoder: bfloat16 is faster, see docs/speed.md"""

    @property
    def spec(self) -> str:
        """The detector's name with weights and precision in it.

        Raises:
            ValueError: weights of a detector that takes none.
        """
        if self.weights is None:
            return precise(self.detector, self.precision)
        if self.detector != "cp_env":
            raise ValueError(f"--weights are of the detector cp_env, not of {self.detector!r}; give one of the two")
        return precise(f"cp_env:weights={self.weights}", self.precision)

    def open_detector(self) -> DetectorLike:
        """The detector itself.

        Raises:
            ValueError: an unknown name, or weights that cannot be read.
        """
        return open_detector(self.spec, fusion=self.fusion)


def command_line(program: str, argv: list[str] | None) -> str:
    """The command as it was typed."""
    return shlex.join([program, *(sys.argv[1:] if argv is None else argv)])


def run_program(
    program: str, args: type[A], body: Callable[[A, str], Any], doc: str | None, argv: list[str] | None
) -> None:
    """Read the command line, run the body, and say what is wrong in one line.

    Args:
        program: its name.
        args: its options.
        body: takes options and the command as it was typed.
        doc: of the help page.
        argv: the command line's unless given.
    """
    use_current_folder()
    options = tyro.cli(args, prog=program, description=doc, args=argv)
    command = command_line(program, argv)
    ending(program, lambda: body(options, command))


def ending(program: str, body: Callable[[], Any]) -> None:
    """Run the body on one torch thread; bad input, missing extras and failed runs end it with what is wrong."""
    torch.set_num_threads(1)
    keep_freed_memory()
    try:
        body()
    except (ValueError, ImportError, FailedRuns) as error:
        raise SystemExit(f"{program}: {error}") from error
