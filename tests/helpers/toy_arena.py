"""`cp-arena` on toy scenes (`--scenes toy:any`) under a toy detector, to be run as a process of its own."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cp_env.evaluation.execution.workers
from agents.arena.cli import main
from cp_env.detector import Detector
from cp_env.scenes import SOURCES
from tests.helpers.toy_evaluation import toy_bank
from tests.helpers.toy_scenes import ToySource


class NamedToy(ToySource):
    """The toy crossings as a kind of scenes."""

    def __init__(self, path: str) -> None:
        del path
        super().__init__(n_frames=4)


class Elsewhere(ToySource):
    """Other toy crossings, on which attacks are screened."""

    def __init__(self, path: str) -> None:
        del path
        super().__init__(n_frames=5)
        self.name, self.digest = "elsewhere", f"elsewhere-{self.digest}"


def toy_detector(detector: str, fusion: str, precision: str = "float32") -> Detector:
    """In the place of those that ship."""
    assert (detector, fusion, precision) == ("cp_env", "mean", "float32")
    return toy_bank().detector


def install(setitem: Callable[..., Any] = dict.__setitem__, set_attribute: Callable[..., Any] = setattr) -> None:
    """Make the scenes known, and the detector the one that is loaded."""
    setitem(SOURCES, "toy", "tests.helpers.toy_arena:NamedToy")
    setitem(SOURCES, "elsewhere", "tests.helpers.toy_arena:Elsewhere")
    set_attribute(cp_env.evaluation.execution.workers, "open_detector", toy_detector)


if __name__ in ("__main__", "__mp_main__"):  # its workers, too
    install()

if __name__ == "__main__":
    main()
