"""Workers that execute runs: this process, several of this machine, or a Ray cluster; results do not depend on them."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from cp_env.attack import Attack, Learned
from cp_env.detector.model.weights import read_detector
from cp_env.detector.protocol import DetectorLike
from cp_env.detector.registry import open_detector
from cp_env.evaluation.execution.processes import Call, Failure, attempt, in_processes
from cp_env.evaluation.execution.ray import on_ray
from cp_env.evaluation.plan.runs import Conditions
from cp_env.scenes import open_source
from cp_env.world.scene_cache import SceneBank
from cp_env.world.situation import Clock

MakeAttack = Callable[..., Attack | Learned]
T = TypeVar("T")
_opened: dict[tuple[str | None, ...], SceneBank] = {}


def open_bank(conditions: Conditions) -> SceneBank:
    """The bank of the conditions' scenes under their detector, one a process: the one last opened is kept.

    Raises:
        ValueError: weights that cannot be read, or that fuse otherwise than the conditions say.
    """
    source = open_source(conditions.scenes)
    key = (source.digest, conditions.fusion, conditions.weights, conditions.detector, conditions.precision)
    if key not in _opened:
        _opened.clear()
        if conditions.weights is None:
            detector: DetectorLike = open_detector(
                conditions.detector, fusion=conditions.fusion, precision=conditions.precision
            )
        else:
            detector = trained = read_detector(Path(conditions.weights)).freeze().with_precision(conditions.precision)
            if trained.fusion != conditions.fusion:
                raise ValueError(
                    f"{conditions.weights} fuse by {trained.fusion}; choose that fusion, not {conditions.fusion}"
                )
        _opened[key] = SceneBank(source, detector, progress=False)
    return _opened[key]


@dataclass(frozen=True, kw_only=True)
class Workers:
    """The processes that execute runs, their torch threads, and how attacks are made.

    Args:
        make_attack: from "pgd:steps=30" to an attack; importable by name if there are several processes.
        processes: number of them.
        threads: torch threads of each.
        ray: address of a Ray cluster, which takes the place of `processes`; "": see `on_ray`.
        open_bank: from conditions to encoded scenes.
        clock: measures the time of the world's steps.

    Raises:
        ValueError: no processes or no threads.
    """

    make_attack: MakeAttack  # spec -> attack; importable by name if there are several processes
    processes: int = 1
    threads: int = 1
    ray: str | None = None  # a Ray cluster's address, which takes the place of `processes`; "": see `on_ray`
    open_bank: Callable[[Conditions], SceneBank] = open_bank
    clock: Clock = time.perf_counter

    def __post_init__(self) -> None:
        if self.processes < 1 or self.threads < 1:
            raise ValueError(f"processes and threads must be at least 1, not {self.processes} and {self.threads}")

    def each(self, task: Callable[..., T], calls: Sequence[Call]) -> Iterator[tuple[int, T | Failure]]:
        """`task(*call)` for every call: its number and its result, in order in this process, else as they come."""
        if self.ray is not None:
            return on_ray(task, calls, self.ray, self.threads)
        if self.processes > 1 and len(calls) > 1:
            return in_processes(task, calls, self.processes, self.threads)
        return ((number, attempt(task, call)) for number, call in enumerate(calls))
