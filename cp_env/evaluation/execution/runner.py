"""Execution of a plan: finished runs are skipped, the rest is played, and a failing run does not hold up the others."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import defenders
from cp_env.evaluation.execution.failures import EpisodeFailures, FailedRuns
from cp_env.evaluation.execution.processes import Failure
from cp_env.evaluation.execution.rollout import play
from cp_env.evaluation.execution.workers import Workers
from cp_env.evaluation.plan.checksum import COPIES, Fault, copies, warn_of
from cp_env.evaluation.plan.files import check_writable, remove_drafts
from cp_env.evaluation.plan.grid import Job
from cp_env.evaluation.plan.records import Record, Store
from cp_env.evaluation.plan.runs import Conditions, Run
from defenders.sealed import seal


def prepare(runs: Sequence[Run], conditions: Conditions, workers: Workers) -> Iterator[str]:
    """Open every scene once, so that what is broken is said before hours of play; yields the name of each.

    Frames are encoded when they are played.

    Raises:
        ValueError: before anything is opened, a defender or an attack of the runs that cannot be made; or a scene that
            cannot be opened.
    """
    for defender in {run.defender: None for run in runs}:
        seal(defender) if conditions.sealed else defenders.make(defender)
    for attack in {run.attack: None for run in runs}:
        workers.make_attack(attack)
    for number, done in workers.each(_open, [(name, conditions, workers) for name in conditions.names]):
        if isinstance(done, Failure):
            raise ValueError(f"cannot open scene {conditions.names[number]!r}: {done}")
        yield done


def execute(runs: Sequence[Run], conditions: Conditions, store: Store, workers: Workers) -> Iterator[Run]:
    """`execute_all` for runs under the same conditions."""
    for run, *_ in execute_all([(run, conditions, store) for run in runs], workers):
        yield run


def execute_all(jobs: Sequence[Job], workers: Workers) -> Iterator[Job]:
    """Play the runs that their store does not hold; yields each job when it is finished.

    Whatever ends the execution, finished runs stay; the same call goes on. The results do not depend on how often it
    was interrupted, nor on the workers. Stored files that cannot be used are named in a warning and played anew; what
    killed writers left behind is removed. The failure of a defender ends its episode and is reported on standard error
    with its traceback, once for each kind.

    Raises:
        CannotWrite: before anything is played, a store that cannot be written; or the disk is full later on.
        FailedRuns: when all else is played, if a run's defender, attack or worker broke down.
    """
    for root in {store.root: None for _, _, store in jobs}:
        remove_drafts(root)
    todo, faults = [], _strangers(jobs)
    for job in jobs:
        run, conditions, store = job
        found = store.examine(run, conditions)
        if isinstance(found, tuple):
            yield job
            continue
        todo.append(job)
        if found is not None:
            faults.append(found)
    warn_of([fault for fault in faults if fault.kind != COPIES])
    warn_of([fault for fault in faults if fault.kind == COPIES], "they are left alone, and not counted")
    for folder in {store.folder: None for _, _, store in todo}:
        check_writable(folder)
    failed, ended = [], EpisodeFailures()
    for number, done in workers.each(_play, [(run, conditions, workers) for run, conditions, _ in todo]):
        run, conditions, store = todo[number]
        if isinstance(done, Failure):
            failed.append((run, done))
            continue
        store.write(run, conditions, done)
        ended.report(run, done)
        yield todo[number]
    if failed:
        raise FailedRuns(failed, [run for run, _, _ in jobs])


def _strangers(jobs: Sequence[Job]) -> list[Fault]:
    """Files in the stores of the jobs that are not what their names say."""
    planned: dict[Path, list[Path]] = {}
    for run, conditions, store in jobs:
        planned.setdefault(store.folder, []).append(store.path(run, conditions))
    return [fault for folder, paths in planned.items() for fault in copies(folder, paths)]


def _open(name: str, conditions: Conditions, workers: Workers) -> str:
    workers.open_bank(conditions).episode(name, conditions.n_vehicles, conditions.rsu)
    return name


def _play(run: Run, conditions: Conditions, workers: Workers) -> list[Record]:
    """The run's records. Whoever's process was killed may not be to blame: the run is played once more, and counts."""
    records = _played(run, conditions, workers)
    killed = any(record.failure is not None and record.failure.killed for record in records)
    return _played(run, conditions, workers) if killed else records


def _played(run: Run, conditions: Conditions, workers: Workers) -> list[Record]:
    return play(run, conditions, workers.open_bank(conditions), workers.make_attack(run.attack), workers.clock)
