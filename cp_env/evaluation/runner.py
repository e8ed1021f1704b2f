"""Play a plan: what is finished is skipped, the rest is played, in this process or in several."""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TypeVar

import torch

from cp_env.bank import SceneBank
from cp_env.detector import load_detector
from cp_env.detector.weights import read_detector
from cp_env.evaluation.cells import Cell, Protocol, parse
from cp_env.evaluation.stage import Attacker, Clock, Learned, open_defender, play
from cp_env.evaluation.store import Store
from cp_env.scenes import open_source

MakeAttacker = Callable[..., Attacker | Learned]
T = TypeVar("T")


@lru_cache(maxsize=1)
def open_bank(protocol: Protocol) -> SceneBank:
    """The bank of the protocol's scenes under its detector, one a process.

    Raises ValueError for weights that cannot be read, or that fuse otherwise than the protocol says.
    """
    if protocol.weights is None:
        detector = load_detector(protocol.fusion)
    else:
        detector = read_detector(Path(protocol.weights)).freeze()
        if detector.fusion != protocol.fusion:
            raise ValueError(f"{protocol.weights} fuse by {detector.fusion}; choose that fusion, not {protocol.fusion}")
    return SceneBank(open_source(protocol.scenes), detector, progress=False)


@dataclass(frozen=True, kw_only=True)
class Crew:
    """Who plays: how many processes, each with how many torch threads, and where attackers come from."""

    make_attacker: MakeAttacker  # name, **knobs -> attacker; importable by name if there are several processes
    workers: int = 1
    threads: int = 1
    open_bank: Callable[[Protocol], SceneBank] = open_bank
    clock: Clock = time.perf_counter

    def __post_init__(self) -> None:
        if self.workers < 1 or self.threads < 1:
            raise ValueError(f"workers and threads must be at least 1, not {self.workers} and {self.threads}")


def prepare(cells: Sequence[Cell], protocol: Protocol, crew: Crew) -> Iterator[str]:
    """Encode every scene that the cache does not hold yet, and tell its name when it is there.

    Raises ValueError, before anything is encoded, for a defender or an attacker of the cells that cannot be made.
    """
    for defender in {cell.defender: None for cell in cells}:
        open_defender(defender)
    for attack in {cell.attack: None for cell in cells}:
        name, knobs = parse(attack)
        crew.make_attacker(name, **knobs)
    yield from _each(_encode, [(name, protocol, crew) for name in protocol.names], crew)


def run(cells: Sequence[Cell], protocol: Protocol, store: Store, crew: Crew) -> Iterator[Cell]:
    """Play the cells that the store does not hold, and hand out each cell when it is finished.

    Whatever ends the run, finished cells stay; run it again to go on. The figures do not depend on how often it was
    interrupted, nor on the number of processes.
    """
    todo = []
    for cell in cells:
        if store.read(cell, protocol) is None:
            todo.append(cell)
        else:
            yield cell
    yield from _each(_play_and_store, [(cell, protocol, store, crew) for cell in todo], crew)


def _each(task: Callable[..., T], jobs: Sequence[tuple[object, ...]], crew: Crew) -> Iterator[T]:
    """`task(*job)` for every job, in order in this process or as they come from several."""
    if crew.workers == 1 or len(jobs) < 2:
        yield from (task(*job) for job in jobs)
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(
        crew.workers, mp_context=context, initializer=torch.set_num_threads, initargs=(crew.threads,)
    ) as pool:
        futures: list[Future[T]] = [pool.submit(task, *job) for job in jobs]
        try:
            for future in as_completed(futures):
                yield future.result()
        finally:  # an error, or a caller who stops asking: start nothing new
            pool.shutdown(wait=False, cancel_futures=True)


def _encode(name: str, protocol: Protocol, crew: Crew) -> str:
    crew.open_bank(protocol).episode(name, protocol.n_vehicles, protocol.rsu)
    return name


def _play_and_store(cell: Cell, protocol: Protocol, store: Store, crew: Crew) -> Cell:
    name, knobs = parse(cell.attack)
    records = play(cell, protocol, crew.open_bank(protocol), crew.make_attacker(name, **knobs), crew.clock)
    store.write(cell, protocol, records)
    return cell
