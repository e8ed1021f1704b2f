"""Who plays: this process, several of this machine, or a Ray cluster. The figures do not depend on it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from cp_env.attack import Attacker, Learned
from cp_env.detector import load_detector
from cp_env.detector.model.weights import read_detector
from cp_env.evaluation.execution.processes import Failure, Job, attempt, in_processes
from cp_env.evaluation.execution.ray import on_ray
from cp_env.evaluation.execution.rollout import Clock
from cp_env.evaluation.plan.runs import Protocol
from cp_env.scenes import open_source
from cp_env.world.scene_cache import SceneBank

MakeAttacker = Callable[..., Attacker | Learned]
T = TypeVar("T")
_opened: dict[tuple[str, str, str | None], SceneBank] = {}


def open_bank(protocol: Protocol) -> SceneBank:
    """The bank of the protocol's scenes under its detector, one a process: the one last opened is kept.

    Raises ValueError for weights that cannot be read, or that fuse otherwise than the protocol says.
    """
    source = open_source(protocol.scenes)
    key = (source.digest, protocol.fusion, protocol.weights)
    if key not in _opened:
        _opened.clear()
        if protocol.weights is None:
            detector = load_detector(protocol.fusion)
        else:
            detector = read_detector(Path(protocol.weights)).freeze()
            if detector.fusion != protocol.fusion:
                raise ValueError(
                    f"{protocol.weights} fuse by {detector.fusion}; choose that fusion, not {protocol.fusion}"
                )
        _opened[key] = SceneBank(source, detector, progress=False)
    return _opened[key]


@dataclass(frozen=True, kw_only=True)
class Crew:
    """How many processes play, each with how many torch threads, and where attackers come from."""

    make_attacker: MakeAttacker  # name, **knobs -> attacker; importable by name if there are several processes
    workers: int = 1
    threads: int = 1
    ray: str | None = None  # a Ray cluster's address, which takes the place of `workers`; "": see `on_ray`
    open_bank: Callable[[Protocol], SceneBank] = open_bank
    clock: Clock = time.perf_counter

    def __post_init__(self) -> None:
        if self.workers < 1 or self.threads < 1:
            raise ValueError(f"workers and threads must be at least 1, not {self.workers} and {self.threads}")

    def each(self, task: Callable[..., T], jobs: Sequence[Job]) -> Iterator[tuple[int, T | Failure]]:
        """`task(*job)` for every job: its number and its result, in order in this process, else as they come."""
        if self.ray is not None:
            return on_ray(task, jobs, self.ray, self.threads)
        if self.workers > 1 and len(jobs) > 1:
            return in_processes(task, jobs, self.workers, self.threads)
        return ((number, attempt(task, job)) for number, job in enumerate(jobs))
