"""The command: outsiders enter, errors say what is known, a killed run goes on, and the records hold every figure."""

from __future__ import annotations

import functools
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from agents.arena import cli, make_attacker
from agents.arena.cli import main
from cp_env.evaluation import Cell, Record, summarise
from cp_env.evaluation.analysis.worst_case import damage_a_frame, extremes, mean_of
from cp_env.evaluation.plan.runs import Protocol, code_of
from tests.helpers.toy_arena import install
from tests.helpers.toy_evaluation import contents

ROOT = Path(__file__).parents[3]
MINE = """
from agents.noise import Silence
from defenders import Defender, Query, Verdict


class Halves(Defender):
    def __init__(self, first=2):
        self.first = first

    def reset(self, n_vehicles, rng):
        self.n = n_vehicles

    def inspect(self, frame):
        yield Query([range(self.first), range(self.first, self.n)])
        return Verdict(range(self.first))


class Shout(Silence):
    def __init__(self, level=1.0):
        self.level = level

    def act(self, situation):
        return super().act(situation) + self.level * situation.budget
"""
ENTRIES = (
    "--defenders",
    "none",
    "mine_too:Halves:first=3",
    "oracle",
    "--attackers",
    "pgd:steps=1",
    "mine_too:Shout:level=0.5",
)
SMALL = ("--scenes", "toy:any", "--frames", "3", "--batch", "1", "--seeds", "7", "8", "--workers", "1")


@pytest.fixture(scope="module", autouse=True)
def toys() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        install(patch.setitem, patch.setattr)
        patch.setattr(cli, "find", functools.partial(cli.find, resamples=20))
        yield


@pytest.fixture
def outsiders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with `mine_too.py` in it, which is where we are."""
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.delitem(sys.modules, "mine_too", raising=False)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine_too.py").write_text(MINE)
    code_of.cache_clear()
    return tmp_path


def test_outsiders_enter_by_module_and_class_with_knobs(outsiders: Path, capsys: pytest.CaptureFixture[str]) -> None:
    axes = ("--ks", "2", "1", "--budgets", "0.3", "0.1", "--side-attackers", "pgd:steps=1", "--side-scenes", "1")
    main([*SMALL, *ENTRIES, *axes, "--page", "board/leaders.md", "--grace-frames", "0"])
    out = outsiders / "out" / "arena"
    data = json.loads((out / "arena.json").read_text())
    assert {line["entry"]: line["rank"] is None for line in data["defenders"]} == {
        "none": False,
        "mine_too:Halves:first=3": False,
        "oracle": True,
    }
    assert {line["entry"] for line in data["attackers"]} == {"pgd:steps=1", "mine_too:Shout:level=0.5"}
    assert [(curve["axis"], curve["values"], curve["n_scenes"]) for curve in data["curves"]] == [
        ("k", [1, 2], 1),
        ("budget", [0.1, 0.3], 1),
    ]
    halves = [row for row in data["rows"] if row["defender"].startswith("mine_too")]
    assert halves and all(row["verifications"]["mean"] == 2 for row in halves)
    assert data["about"]["protocol"]["grace_frames"] == 0 and data["about"]["seeds"] == [7, 8]
    assert data["about"]["command"].startswith("cp-arena --scenes toy:any")
    entries = [json.loads(file.read_text()) for file in (out / "entries").iterdir()]
    assert {(entry["role"], entry["entry"]) for entry in entries} == {
        *(("defender", line["entry"]) for line in data["defenders"]),
        *(("attack", line["entry"]) for line in data["attackers"]),
    }
    films = {entry["worst_episode"]["gif"] for entry in entries if entry["role"] == "defender"}
    assert films == {film.name for film in (out / "films").iterdir()}
    pictures = {file.name for file in (outsiders / "board" / "leaders").iterdir()}
    page = (outsiders / "board" / "leaders.md").read_text()
    assert pictures == {
        "defenders.svg",
        "attackers.svg",
        "trade-off.svg",
        "curve-k.svg",
        "curve-budget.svg",
        "worst.gif",
    }
    assert all(f"(leaders/{name})" in page for name in pictures) and "cp-arena --scenes toy:any" in page
    assert "arena.html" in capsys.readouterr().out


def test_a_changed_outsider_is_played_anew(outsiders: Path) -> None:
    protocol = Protocol("toy:any", ("toy-0",))
    cells = [Cell("mine_too:Halves", "none", 0, 0, ("toy-0",)), Cell("prbi", "none", 0, 0, ("toy-0",))]
    sys.path.insert(0, str(outsiders))
    before = [cell.slug(protocol) for cell in cells]
    assert before == [cell.slug(protocol) for cell in cells]
    (outsiders / "mine_too.py").write_text(MINE.replace("first=2", "first=1"))
    code_of.cache_clear()
    mine, ours = [cell.slug(protocol) for cell in cells]
    assert mine != before[0] and ours == before[1]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--defenders", "prbbi"], "unknown defender 'prbbi'; known are prbi, none"),
        (["--defenders", "nowhere:Halves"], "no defender 'nowhere:Halves'"),
        (["--attackers", "pdg"], "unknown attacker 'pdg'; known: none, noise, .*pgd, .*policy:name=…, or module:Class"),
        (["--attackers", "policy:name=prbi-99"], "unknown policy 'prbi-99'; known: .*prbi-0"),
        (["--attackers", "tests.helpers.toy_evaluation:ToySource"], "built a ToySource; an attacker has reset and act"),
        (["--attackers", "pgd:wisdom=1"], "wisdom"),
        (["--design", "round"], "unknown design 'round': choose one of star, full"),
        (["--n-scenes", "3"], "n_scenes must be 1 to 2, not 3"),
        (["--ks", "5"], "0 <= k < n"),
    ],
)
def test_bad_input_is_told_in_one_line(words: list[str], message: str, tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match=f"cp-arena: .*{message}"):
        main(["--scenes", "toy:any", "--out", str(tmp_path), *words])
    assert not contents(tmp_path)


def test_learned_attackers_and_outsiders_are_made_by_name() -> None:
    assert make_attacker("policy", name="prbi-0").knobs["observation"]  # type: ignore[union-attr]
    for place in ("agents.attacks.noise:Silence", "agents.attacks.noise.Silence"):
        assert type(make_attacker(place)).__name__ == "Silence"


# ── killed and gone on with ──────────────────────────────────────────────────────────────────────────────────────────

DUELS = ("--defenders", "none", "prbi", "--attackers", "none", "pgd:steps=1", "--no-films")


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody looks at the pictures."""
    monkeypatch.setattr(cli, "pictures", lambda found: {})


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("uninterrupted")
    main([*SMALL, *DUELS, "--out", str(out)])
    return out


def table(out: Path) -> dict[str, Any]:
    """All that was found, but how fast it went and how it was called."""
    found: dict[str, Any] = json.loads((out / "arena.json").read_text())
    rows = [{**row, "frames_per_second": None} for row in found["rows"]]
    return {**found, "rows": rows, "about": None}


def alive(pid: int) -> bool:
    """Whether that process still runs."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="finds the workers in /proc")
def test_a_run_killed_by_force_goes_on_to_the_same_table(uninterrupted: Path, undrawn: None, tmp_path: Path) -> None:
    words = [*SMALL[:-1], "2", *DUELS, "--out", str(tmp_path)]  # on two workers
    run = subprocess.Popen([sys.executable, "-m", "tests.helpers.toy_arena", *words], cwd=ROOT)
    cells, deadline = tmp_path / "cells", time.monotonic() + 240
    while not (cells.is_dir() and len(contents(cells)) >= 2):
        assert run.poll() is None and time.monotonic() < deadline, "it ended, or did nothing"
        time.sleep(0.02)
    workers = [int(pid) for pid in Path(f"/proc/{run.pid}/task/{run.pid}/children").read_text().split()]
    os.kill(run.pid, signal.SIGKILL)
    run.wait()
    kept, planned = contents(cells), contents(uninterrupted / "cells")
    assert 2 <= len(kept) < len(planned) and kept.keys() <= planned.keys()
    assert all(json.loads(data)["records"] for data in kept.values())  # whole, each of them
    main([*SMALL, *DUELS, "--out", str(tmp_path)])
    assert contents(cells).keys() == planned.keys()
    assert {name: contents(cells)[name] for name in kept} == kept  # nothing is played twice
    assert table(tmp_path) == table(uninterrupted)
    while any(map(alive, workers)):
        assert time.monotonic() < deadline, "a worker outlives its parent"
        time.sleep(0.1)


def test_the_order_of_entries_changes_no_cell(uninterrupted: Path, undrawn: None, tmp_path: Path) -> None:
    """Stored cells are taken for those of a run that names its entries the other way round."""
    shutil.copytree(uninterrupted / "cells", tmp_path / "cells")
    before = contents(tmp_path / "cells")
    turned = ("--defenders", "prbi", "none", "--attackers", "pgd:steps=1", "none", "--no-films", "--seeds", "8", "7")
    main([*SMALL, *turned, "--out", str(tmp_path)])
    assert contents(tmp_path / "cells") == before
    ranks = [{line["entry"]: line["rank"] for line in table(out)["defenders"]} for out in (tmp_path, uninterrupted)]
    assert ranks[0] == ranks[1]


def test_the_records_alone_hold_every_figure(uninterrupted: Path) -> None:
    """Read without the plan: rows and worst cases come out as they were reported."""
    played: dict[Cell, list[Record]] = {}
    for file in sorted((uninterrupted / "cells").iterdir()):
        data = json.loads(file.read_text())
        cell = Cell(*(data[name] for name in ("defender", "attack", "k", "seed")), tuple(data["names"]))
        played[cell] = [Record.from_json(record) for record in data["records"]]
        assert data["conditions"]["frames"] == 3 and data["detector"]
    reported = json.loads((uninterrupted / "arena.json").read_text())
    rows = {(row.defender, row.attack): row for row in summarise(played, resamples=1)}
    for row in reported["rows"]:
        mine = rows[row["defender"], row["attack"]]
        for figure in ("ap50", "recovery70", "damage", "verifications", "mc_rate"):
            theirs, own = row[figure], getattr(mine, figure)
            assert own is None if theirs is None else theirs["mean"] == pytest.approx(own.mean)
    for standing in reported["defenders"]:
        by_scene: dict[str, list[float]] = {}
        for cell, records in played.items():
            if (cell.defender, cell.attack) == (standing["entry"], "pgd:steps=1"):
                for one in records:
                    by_scene.setdefault(one.scene, []).append(damage_a_frame(one, 3))
        worst = extremes({"pgd": {scene: sum(of) / len(of) for scene, of in by_scene.items()}}, max)
        assert standing["damage"]["mean"] == pytest.approx(mean_of(worst).mean)
