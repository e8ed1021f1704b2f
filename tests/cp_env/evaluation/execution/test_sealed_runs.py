"""Sealed runs: equal results, nothing remembered from one run to the next, and a key that hides the episodes."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import agents
import defenders
from cp_env.evaluation import Conditions, Record, Rollout, Run, Store, Workers, execute, plan_runs, play
from cp_env.evaluation.execution.runner import prepare
from defenders import Defender, Frame, Inspection, Verdict
from tests.helpers.toy_evaluation import CONDITIONS, open_toy, ticking, toy_bank, untimed

SEALED = replace(CONDITIONS, sealed=True)
SECRET = replace(CONDITIONS, key="a text that nobody knows, and long at that")
_remembered: list[int] = []


class Elephant(Defender):
    """Flags as many vehicles as it has played episodes in this process: a memory beyond the run."""

    def reset(self, n_vehicles: int, rng: np.random.Generator) -> None:
        del n_vehicles, rng
        _remembered.append(1)

    def inspect(self, frame: Frame) -> Inspection:
        yield from ()
        return Verdict(range(frame.n_vehicles), range(min(len(_remembered), frame.n_vehicles)))


class Mortal(Defender):
    """Its process is killed in the second frame, until the folder says that this has happened often enough."""

    def reset(self, n_vehicles: int, rng: np.random.Generator) -> None:
        del n_vehicles, rng

    def inspect(self, frame: Frame) -> Inspection:
        yield from ()
        deaths = Path(os.environ["CP_ENV_TEST_DEATHS"])
        if frame.index == 1 and len(list(deaths.iterdir())) < int(os.environ["CP_ENV_TEST_LIVES"]):
            (deaths / str(os.getpid())).touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return Verdict(range(frame.n_vehicles))


def outcome(defender: str, conditions: Conditions) -> list[dict[str, object]]:
    run = Run(defender, "pgd:steps=1", 2, 7, conditions.names)
    records = play(run, conditions, toy_bank(), agents.make(run.attack), clock=lambda: 0.0)
    return [record.to_json() for record in records]


@pytest.mark.parametrize("name", defenders.names())
def test_a_sealed_defender_plays_as_an_open_one(name: str) -> None:
    assert outcome(name, SEALED) == outcome(name, CONDITIONS)


def test_a_sealed_defender_remembers_nothing_from_one_run_to_the_next() -> None:
    place = f"{__name__}:Elephant"

    def flagged(conditions: Conditions) -> list[int]:
        return [len(record["suspects"]) for record in outcome(place, conditions)]  # type: ignore[arg-type]

    once = flagged(SEALED)
    assert flagged(SEALED) == once == [2, 2]  # both worlds of the run, and no other run's
    assert flagged(CONDITIONS) == [2, 2]
    assert flagged(CONDITIONS) == [4, 4]  # in the referee's process it does


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no such signal here")
@pytest.mark.parametrize("deaths", [0, 1, 2])
def test_a_run_whose_sealed_process_was_killed_is_played_once_more(
    deaths: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Who kills a process is not known: one death counts for nothing, a second one is the defender's own failure."""
    monkeypatch.setenv("CP_ENV_TEST_DEATHS", str(tmp_path / "deaths"))
    monkeypatch.setenv("CP_ENV_TEST_LIVES", str(deaths))
    (tmp_path / "deaths").mkdir()
    runs = plan_runs(SEALED, defenders=(f"{__name__}:Mortal",), attacks=("none",), ks=(1,), seeds=(0,))
    store = Store(tmp_path / "out")
    list(execute(runs, SEALED, store, ticking(make_attack=agents.make)))
    (records,) = store.load(runs, SEALED).values()
    assert len(list((tmp_path / "deaths").iterdir())) == deaths
    if deaths < 2:
        assert all(record.error is None and len(record.damage) == SEALED.frames for record in records)
    else:
        assert all("was killed" in (record.error or "") and len(record.damage) == 2 for record in records)


def test_what_cannot_be_sealed_is_said_before_anything_is_played() -> None:
    runs = plan_runs(SEALED, defenders=("prbi:thresold=1",), attacks=("none",), ks=(1,), seeds=(0,))
    with pytest.raises(ValueError, match="threshold"):
        list(prepare(runs, SEALED, ticking(make_attack=agents.make)))


def test_sealed_and_open_runs_are_stored_apart(workers: Workers, tmp_path: Path) -> None:
    store = Store(tmp_path)

    def stored(conditions: Conditions) -> Iterator[tuple[Record, ...]]:
        runs = plan_runs(conditions, defenders=("none",), attacks=("none",), ks=(1,), seeds=(0,))
        list(execute(runs, conditions, store, workers))
        yield from store.load(runs, conditions).values()

    everything = [list(stored(conditions)) for conditions in (CONDITIONS, SEALED, SECRET)]
    assert len(list(tmp_path.rglob("*.json"))) == 3
    assert all(everything)


def test_a_key_draws_other_episodes_and_is_not_told() -> None:
    def attackers(conditions: Conditions) -> list[list[int]]:
        runs = [Run("none", "none", 2, seed, conditions.names) for seed in range(8)]
        drawn = [Rollout(run, conditions, toy_bank(), agents.make("none")).world.attackers for run in runs]
        return [numbers.tolist() for numbers in drawn]

    assert attackers(SECRET) != attackers(CONDITIONS)
    assert attackers(SECRET) == attackers(replace(SECRET))
    assert SECRET.key not in repr(SECRET)
    assert SECRET.key not in repr(SECRET.describe())
    assert SECRET.describe()["key"] != replace(SECRET, key=SECRET.key + "!").describe()["key"]
    assert "key" not in CONDITIONS.describe()


def test_untimed_results_of_a_sealed_benchmark_do_not_depend_on_the_processes(tmp_path: Path) -> None:
    def played(processes: int) -> dict[Run, list[dict[str, object]]]:
        store = Store(tmp_path / str(processes))
        runs = plan_runs(SEALED, defenders=("prbi",), attacks=("none", "pgd:steps=1"), ks=(2,), seeds=(0,), batch=1)
        workers = Workers(make_attack=agents.make, open_bank=open_toy, processes=processes)
        list(execute(runs, SEALED, store, workers))
        return untimed(store.load(runs, SEALED))

    assert played(1) == played(2)
