"""Execution of a plan: finished runs are skipped, the rest is played, and a failing run does not hold up the others."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import defenders
from cp_env.evaluation.execution.processes import Failure
from cp_env.evaluation.execution.rollout import play
from cp_env.evaluation.execution.workers import Workers
from cp_env.evaluation.plan.grid import Job
from cp_env.evaluation.plan.records import Record, Store
from cp_env.evaluation.plan.runs import Conditions, Run


class FailedRuns(RuntimeError):
    """Some runs could not be played. All others were, and are stored; the next execution tries these again."""

    def __init__(self, failed: Sequence[tuple[Run, str]], n_runs: int) -> None:
        lines = (f"  {run}: {why}" for run, why in failed)
        super().__init__("\n".join([f"{len(failed)} of {n_runs} runs failed, all others are stored:", *lines]))
        self.failed = tuple(failed)


def prepare(runs: Sequence[Run], conditions: Conditions, workers: Workers) -> Iterator[str]:
    """Encode every scene that the cache does not hold yet; yields the name of each that is there.

    Raises:
        ValueError: before anything is encoded, a defender or an attack of the runs that cannot be made; or a scene that
            cannot be encoded.
    """
    for defender in {run.defender: None for run in runs}:
        defenders.make(defender)
    for attack in {run.attack: None for run in runs}:
        workers.make_attack(attack)
    for number, done in workers.each(_encode, [(name, conditions, workers) for name in conditions.names]):
        if isinstance(done, Failure):
            raise ValueError(f"cannot encode scene {conditions.names[number]!r}: {done.reason}")
        yield done


def execute(runs: Sequence[Run], conditions: Conditions, store: Store, workers: Workers) -> Iterator[Run]:
    """`execute_all` for runs under the same conditions."""
    for run, *_ in execute_all([(run, conditions, store) for run in runs], workers):
        yield run


def execute_all(jobs: Sequence[Job], workers: Workers) -> Iterator[Job]:
    """Play the runs that their store does not hold; yields each job when it is finished.

    Whatever ends the execution, finished runs stay; the same call goes on. The results do not depend on how often it
    was interrupted, nor on the workers.

    Raises:
        FailedRuns: when all else is played, if a run's defender, attack or worker broke down.
    """
    todo = []
    for job in jobs:
        run, conditions, store = job
        if store.read(run, conditions) is None:
            todo.append(job)
        else:
            yield job
    failed = []
    for number, done in workers.each(_play, [(run, conditions, workers) for run, conditions, _ in todo]):
        run, conditions, store = todo[number]
        if isinstance(done, Failure):
            failed.append((run, done.reason))
            continue
        store.write(run, conditions, done)
        yield todo[number]
    if failed:
        raise FailedRuns(failed, len(jobs))


def _encode(name: str, conditions: Conditions, workers: Workers) -> str:
    workers.open_bank(conditions).episode(name, conditions.n_vehicles, conditions.rsu)
    return name


def _play(run: Run, conditions: Conditions, workers: Workers) -> list[Record]:
    return play(run, conditions, workers.open_bank(conditions), workers.make_attack(run.attack), workers.clock)
