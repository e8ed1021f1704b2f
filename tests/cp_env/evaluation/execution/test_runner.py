"""Execution of a plan: it can be killed, goes on where it stopped, and no run depends on its neighbours."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import agents
from cp_env.evaluation import Conditions, Run, Store, Workers, execute, plan_runs, prepare
from cp_env.world.scene_cache import SceneBank
from tests.helpers.toy_evaluation import CONDITIONS, RUNS, contents, report


def failing(after: int) -> Callable[..., Any]:
    """`agents.make` that breaks down after so many attacks."""
    left = iter(range(after))

    def make(name: str, **options: Any) -> Any:
        if next(left, None) is None:
            raise KeyboardInterrupt
        return agents.make(name, **options)

    return make


@pytest.mark.parametrize("after", [1, len(RUNS) - 1])
def test_a_killed_run_goes_on_where_it_stopped_and_ends_byte_equal(
    whole: Path, workers: Workers, tmp_path: Path, after: int
) -> None:
    with pytest.raises(KeyboardInterrupt):
        list(execute(RUNS, CONDITIONS, Store(tmp_path), replace(workers, make_attack=failing(after))))
    assert len(contents(tmp_path)) == after

    rest = failing(len(RUNS) - after)  # one attack more than is left would break down
    assert set(execute(RUNS, CONDITIONS, Store(tmp_path), replace(workers, make_attack=rest))) == set(RUNS)
    report(tmp_path)
    assert contents(tmp_path) == contents(whole)


def test_a_broken_run_is_played_again(whole: Path, workers: Workers, tmp_path: Path) -> None:
    for name, data in contents(whole).items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(data)
    torn = Store(tmp_path).path(RUNS[3], CONDITIONS)
    torn.write_bytes(torn.read_bytes()[:200])
    assert Store(tmp_path).read(RUNS[3], CONDITIONS) is None
    assert len(list(execute(RUNS, CONDITIONS, Store(tmp_path), replace(workers, make_attack=failing(1))))) == len(RUNS)
    assert contents(tmp_path) == contents(whole)


def test_scenes_in_lock_step_give_what_each_gives_alone(whole: Path, workers: Workers, tmp_path: Path) -> None:
    pairs = plan_runs(CONDITIONS, defenders=("prbi",), attacks=("pgd:steps=1",), ks=(2,), seeds=(7,), batch=2)
    list(execute(pairs, CONDITIONS, Store(tmp_path), workers))
    together = Store(tmp_path).load(pairs, CONDITIONS)[pairs[0]]
    alone = Store(whole).load(RUNS, CONDITIONS)
    for record in together:
        run = Run("prbi", "pgd:steps=1", 2, 7, (record.scene,))
        assert replace(record, seconds=0.0).to_json() == replace(alone[run][0], seconds=0.0).to_json()


def test_all_defenders_and_attacks_meet_the_same_attackers(whole: Path) -> None:
    met: dict[tuple[str, int], set[tuple[int, ...]]] = {}
    for run, (record,) in Store(whole).load(RUNS, CONDITIONS).items():
        assert len(record.attackers) == run.k
        assert len(record.damage) == CONDITIONS.frames
        met.setdefault((record.scene, run.k), set()).add(record.attackers)
    assert all(len(attackers) == 1 for attackers in met.values())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"defenders": ("prbbi",)}, "unknown defender 'prbbi'"),
        ({"defenders": ("prbi:wisdom=1",)}, "wisdom"),
        ({"defenders": ("tests.helpers.toy_evaluation:Nobody",)}, "no defender 'tests.helpers.toy_evaluation:Nobody'"),
        ({"defenders": ("no.such.module:Class",)}, "name one of prbi"),
        ({"attacks": ("pdg",)}, "unknown attack 'pdg'"),
    ],
)
def test_what_cannot_be_made_is_refused_before_anything_is_encoded(
    workers: Workers, change: dict[str, Any], message: str
) -> None:
    good: dict[str, Any] = {"defenders": ("none",), "attacks": ("pgd",), "ks": (1,), "seeds": (0,)}
    runs = plan_runs(CONDITIONS, **{**good, **change})

    def never(_: Conditions) -> SceneBank:
        raise AssertionError

    with pytest.raises(ValueError, match=message):
        list(prepare(runs, CONDITIONS, replace(workers, open_bank=never)))
