"""Playing a plan: it can be killed, goes on where it stopped, and does not depend on what stands beside a cell."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import agents
from cp_env.evaluation import Cell, Crew, Protocol, Store, plan, prepare, run
from cp_env.world.scene_cache import SceneBank
from tests.helpers.toy_evaluation import CELLS, PROTOCOL, contents, report


def failing(after: int) -> Callable[..., Any]:
    """`agents.make` that breaks down after so many attackers."""
    left = iter(range(after))

    def make(name: str, **knobs: Any) -> Any:
        if next(left, None) is None:
            raise KeyboardInterrupt
        return agents.make(name, **knobs)

    return make


@pytest.mark.parametrize("after", [1, len(CELLS) - 1])
def test_a_killed_run_goes_on_where_it_stopped_and_ends_byte_equal(
    whole: Path, crew: Crew, tmp_path: Path, after: int
) -> None:
    with pytest.raises(KeyboardInterrupt):
        list(run(CELLS, PROTOCOL, Store(tmp_path), replace(crew, make_attacker=failing(after))))
    assert len(contents(tmp_path)) == after

    rest = failing(len(CELLS) - after)  # one attacker more than is left would break down
    assert set(run(CELLS, PROTOCOL, Store(tmp_path), replace(crew, make_attacker=rest))) == set(CELLS)
    report(tmp_path)
    assert contents(tmp_path) == contents(whole)


def test_a_broken_cell_is_played_again(whole: Path, crew: Crew, tmp_path: Path) -> None:
    for name, data in contents(whole).items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(data)
    torn = Store(tmp_path).path(CELLS[3], PROTOCOL)
    torn.write_bytes(torn.read_bytes()[:200])
    assert Store(tmp_path).read(CELLS[3], PROTOCOL) is None
    assert len(list(run(CELLS, PROTOCOL, Store(tmp_path), replace(crew, make_attacker=failing(1))))) == len(CELLS)
    assert contents(tmp_path) == contents(whole)


def test_scenes_in_lock_step_give_what_each_gives_alone(whole: Path, crew: Crew, tmp_path: Path) -> None:
    pairs = plan(PROTOCOL, defenders=("prbi",), attacks=("pgd:steps=1",), ks=(2,), seeds=(7,), batch=2)
    list(run(pairs, PROTOCOL, Store(tmp_path), crew))
    together = Store(tmp_path).load(pairs, PROTOCOL)[pairs[0]]
    alone = Store(whole).load(CELLS, PROTOCOL)
    for record in together:
        cell = Cell("prbi", "pgd:steps=1", 2, 7, (record.scene,))
        assert replace(record, seconds=0.0).to_json() == replace(alone[cell][0], seconds=0.0).to_json()


def test_all_defenders_and_attacks_meet_the_same_liars(whole: Path) -> None:
    met: dict[tuple[str, int], set[tuple[int, ...]]] = {}
    for cell, (record,) in Store(whole).load(CELLS, PROTOCOL).items():
        assert len(record.liars) == cell.k
        assert len(record.damage) == PROTOCOL.frames
        met.setdefault((record.scene, cell.k), set()).add(record.liars)
    assert all(len(liars) == 1 for liars in met.values())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"defenders": ("prbbi",)}, "unknown defender 'prbbi'"),
        ({"defenders": ("prbi:wisdom=1",)}, "wisdom"),
        ({"defenders": ("tests.helpers.toy_evaluation.Nobody",)}, "no defender 'tests.helpers.toy_evaluation.Nobody'"),
        ({"defenders": ("no.such.module",)}, "name one of prbi"),
        ({"attacks": ("pdg",)}, "unknown attacker 'pdg'"),
    ],
)
def test_what_cannot_be_made_is_refused_before_anything_is_encoded(
    crew: Crew, change: dict[str, Any], message: str
) -> None:
    good: dict[str, Any] = {"defenders": ("none",), "attacks": ("pgd",), "ks": (1,), "seeds": (0,)}
    cells = plan(PROTOCOL, **{**good, **change})

    def never(_: Protocol) -> SceneBank:
        raise AssertionError

    with pytest.raises(ValueError, match=message):
        list(prepare(cells, PROTOCOL, replace(crew, open_bank=never)))
