"""Execution of a plan: it can be killed, goes on where it stopped, and no run depends on its neighbours."""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import agents
from cp_env.evaluation import Conditions, Run, Store, Workers, execute, plan_runs, prepare
from cp_env.evaluation.plan import files
from cp_env.evaluation.plan.checksum import StoredRunWarning
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
    with pytest.warns(StoredRunWarning, match=f"were cut or changed .*played anew: {torn.name[:20]}"):
        done = list(execute(RUNS, CONDITIONS, Store(tmp_path), replace(workers, make_attack=failing(1))))
    assert len(done) == len(RUNS)
    assert contents(tmp_path) == contents(whole)


def test_all_that_is_wrong_with_a_store_is_told_once_a_kind(whole: Path, workers: Workers, tmp_path: Path) -> None:
    shutil.copytree(whole / "runs", tmp_path / "runs")
    store = Store(tmp_path)
    paths = [store.path(run, CONDITIONS) for run in RUNS]
    paths[0].write_bytes(b"")
    paths[1].write_bytes(b"")
    shutil.copy(paths[2], paths[3])
    copy = paths[2].with_name("copy.json")
    shutil.copy(paths[2], copy)
    draft = (
        tmp_path / "runs" / f".x.json.{files._machine()}.4194305{files.DRAFT}"
    )  # more than a process's number can be
    draft.touch()
    with pytest.warns(StoredRunWarning) as caught:
        list(execute(RUNS, CONDITIONS, store, replace(workers, make_attack=failing(3))))
    said = [str(warning.message) for warning in caught]
    assert [text.split()[0] for text in said] == ["2", "1", "1"]
    assert "are empty" in said[0] and paths[3].name in said[1] and "left alone" in said[2] and "copy.json" in said[2]
    assert not draft.exists() and copy.exists()
    copy.unlink()
    assert contents(tmp_path / "runs") == contents(whole / "runs")


def test_a_store_that_cannot_be_written_is_refused_before_anything_is_played(workers: Workers, tmp_path: Path) -> None:
    (tmp_path / "out").write_text("a file")
    with pytest.raises(ValueError, match=r"cannot write .*out.*give another folder"):
        list(execute(RUNS, CONDITIONS, Store(tmp_path / "out"), replace(workers, make_attack=failing(0))))


def test_a_disk_that_fills_up_loses_no_finished_run(
    whole: Path, workers: Workers, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sync, left = os.fsync, iter(range(3))  # one for the probe, two runs

    def full(number: int) -> None:
        if next(left, None) is None:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        sync(number)

    with monkeypatch.context() as patch:
        patch.setattr(files.os, "fsync", full)
        with pytest.raises(ValueError, match=r"cannot write .*\(No space left on device\): make room") as caught:
            list(execute(RUNS, CONDITIONS, Store(tmp_path), workers))
    assert "\n" not in str(caught.value)
    assert len(contents(tmp_path)) == 2 and not list((tmp_path / "runs").glob(".*"))
    assert set(execute(RUNS, CONDITIONS, Store(tmp_path), workers)) == set(RUNS)


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
