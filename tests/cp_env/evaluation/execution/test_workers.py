"""Who plays does not matter: several processes or a Ray cluster give what one process gives, and outlive their dead."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import pytest

from agents.arena import make_attacker
from cp_env.evaluation import Crew, FailedCells, Store, plan, run
from tests.helpers.toy_evaluation import CELLS, PROTOCOL, open_toy, untimed

NO_RAY = pytest.mark.skipif(find_spec("ray") is None, reason="ray is not installed: pip install -e '.[ray]'")
CREWS = [
    pytest.param({"workers": 2}, id="two-processes"),
    pytest.param({"ray": "local"}, id="ray", marks=NO_RAY),
]


@pytest.mark.parametrize("who", CREWS)
def test_who_plays_changes_no_figure_and_a_dead_worker_costs_its_cell(
    who: dict[str, str], whole: Path, tmp_path: Path
) -> None:
    bad = plan(
        PROTOCOL,
        defenders=("none",),
        attacks=("tests.helpers.toy_evaluation:Fatal", "tests.helpers.toy_evaluation:Clumsy"),
        ks=(2,),
        seeds=(7,),
    )
    crew = Crew(make_attacker=make_attacker, open_bank=open_toy, **who)  # type: ignore[arg-type]
    store, done = Store(tmp_path), []
    with pytest.raises(FailedCells, match=f"2 of {len(CELLS) + 2} cells failed, all others are stored") as caught:
        for cell in run([*bad, *reversed(CELLS)], PROTOCOL, store, crew):
            done.append(cell)
    assert set(done) == set(CELLS)
    assert untimed(store.load(CELLS, PROTOCOL)) == untimed(Store(whole).load(CELLS, PROTOCOL))
    why = {cell.attack.rpartition(":")[2]: reason for cell, reason in caught.value.failed}
    assert why["Clumsy"] == "RuntimeError: stumbled in frame 0" and "died" in why["Fatal"]
    assert "none against tests.helpers.toy_evaluation:Clumsy, k = 2, seed 7, on toy-0, toy-1: " in str(caught.value)
    again = plan(PROTOCOL, defenders=("none",), attacks=("tests.helpers.toy_evaluation:Clumsy",), ks=(2,), seeds=(7,))
    assert store.load(again, PROTOCOL) == {}  # a failed cell is tried again by the next run


def test_a_crew_of_one_goes_on_over_failures_too(tmp_path: Path) -> None:
    attacks = ("tests.helpers.toy_evaluation:Clumsy", "none")
    cells = plan(PROTOCOL, defenders=("none",), attacks=attacks, ks=(2,), seeds=(7,))
    crew = Crew(make_attacker=make_attacker, open_bank=open_toy)
    with pytest.raises(FailedCells, match="1 of 2 cells failed"):
        list(run(cells, PROTOCOL, Store(tmp_path), crew))
    assert list(Store(tmp_path).load(cells, PROTOCOL)) == [cell for cell in cells if cell.attack == "none"]


def test_without_ray_the_extra_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(__import__("sys").modules, "ray", None)
    crew = Crew(make_attacker=make_attacker, open_bank=open_toy, ray="")
    with pytest.raises(ImportError, match=r"pip install 'cp-env\[ray\]'"):
        list(run(CELLS, PROTOCOL, Store(tmp_path), crew))
