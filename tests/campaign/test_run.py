"""The program: cases are tried once, kept at once, tried again if need be; tables say what was tried and no more."""

from __future__ import annotations

import json
import signal
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from rich.console import Console

from tests.campaign import run
from tests.campaign.case import Case, Fault, Figures, Result, try_case
from tests.campaign.ledger import Ledger, code_digest
from tests.campaign.processes import alive, started
from tests.campaign.report import BEGIN, END, tables, write_tables

QUIET = Console(quiet=True)


def case(name: str, seen: list[str], play: Callable[[Path], Figures] | None = None) -> Case:
    def counted(folder: Path) -> Figures:
        seen.append(name)
        assert folder.is_dir() and not list(folder.iterdir())
        return play(folder) if play else {"kills": 1}

    return Case("kills", name, counted)


def _breaks(folder: Path) -> Figures:
    raise Fault("it does not hold")


def _crashes(folder: Path) -> Figures:
    raise KeyError(folder.name)


def test_results_are_kept_and_not_tried_twice(tmp_path: Path) -> None:
    seen: list[str] = []
    cases = [case("a", seen), case("b", seen, _breaks), case("c", seen, _crashes)]
    for code, tried in (("x", ["a", "b", "c"]), ("x", ["b", "c"]), ("y", ["a", "b", "c"])):
        seen.clear()
        ledger = Ledger(tmp_path / "results.jsonl")
        results = run.campaign(cases, ledger, code, tmp_path / code, QUIET)
        assert seen == tried
        assert [result.holds for result in results] == [True, False, False]
        assert "it does not hold" in results[1].why and "KeyError" in results[2].why
        assert not list((tmp_path / code).glob("*"))


def test_a_campaign_that_was_killed_goes_on(tmp_path: Path) -> None:
    seen: list[str] = []

    def killed(folder: Path) -> Figures:
        raise KeyboardInterrupt

    file = tmp_path / "results.jsonl"
    with pytest.raises(KeyboardInterrupt):
        run.campaign([case("a", seen), case("b", seen, killed)], Ledger(file), "x", tmp_path / "1", QUIET)
    file.write_text(file.read_text() + '{"part": "kills", "na')  # cut off
    run.campaign([case("a", seen), case("b", seen)], Ledger(file), "x", tmp_path / "2", QUIET)
    assert seen == ["a", "b", "b"]
    assert {result.name for result in Ledger(file).results.values()} == {"a", "b"}
    assert [json.loads(line)["name"] for line in file.read_text().splitlines() if line.endswith("}")] == ["a", "b"]


def test_a_campaign_that_is_terminated_takes_along_what_it_started(tmp_path: Path) -> None:
    """What it started bears a mark of its own, so it is known as its child."""
    words = ["-m", "tests.campaign.run", "--parts", "kills", "--kills", "1", "--out"]
    with started([*words, str(tmp_path / "campaign")], tmp_path) as program:
        begin, of = time.monotonic(), Path(f"/proc/{program.process.pid}/task/{program.process.pid}/children")
        while not (children := [int(number) for number in of.read_text().split()]):
            assert not program.ended() and time.monotonic() - begin < 300, program.said()
            time.sleep(0.05)
        program.process.terminate()
        assert program.wait(60) == 128 + signal.SIGTERM, program.said()
        assert not [number for number in children if alive(number)]


def test_the_code_is_what_results_can_depend_on(tmp_path: Path) -> None:
    for package in ("cp_env", "defenders", "agents"):
        (tmp_path / package).mkdir()
    module = tmp_path / "cp_env/a.py"
    module.write_text("a = 1")
    before = code_digest(tmp_path)
    (tmp_path / "cp_env/a.pyc").write_bytes(b"1")
    (tmp_path / "elsewhere.py").write_text("a = 1")
    assert code_digest(tmp_path) == before
    module.write_text("a = 2")
    assert code_digest(tmp_path) != before


def test_parts_are_chosen_and_sizes_given() -> None:
    plan = run.planned(run.Args(parts=("kills", "inputs"), kills=7, inputs=1000))
    assert {made.part for made in plan} == {"kills", "inputs"}
    assert run.planned(run.Args(parts=())) == []
    assert {made.part for made in run.planned(run.Args())} == set(run.PARTS)
    with pytest.raises(ValueError, match="unknown parts soaks; the parts are kills, inputs, soak"):
        run.planned(run.Args(parts=("soaks",)))
    some = run.planned(run.Args(parts=("kills",), only=("chain 3,", "chain 14,")))
    assert [case.name.split(",")[0] for case in some] == ["chain 3", "chain 14"]
    with pytest.raises(ValueError, match="chain 99"):
        run.planned(run.Args(only=("chain 99,",)))


KILLS = {"kills": 5, "program": 3, "worker": 2, "sealed": 0, "encoding": 1, "compared": 2, "longest_orphan_s": 0.4}
INPUTS = {"family": "names", "inputs": 20_000, "taken": 5000, "refused": 15_000, "grown_mb": 7.4}
SOAK = {"minutes": 30.0, "resets": 12_000, "frames": 60_000, "memory_mb": 900.5, "slope_mb_per_hour": -0.3}


def test_tables_add_up_what_holds_and_name_what_does_not(tmp_path: Path) -> None:
    handles = {"files": 9, "threads": 2, "children": 0, "shared": 1}
    results = [
        Result("kills", "chain 0", True, 9.0, "x", {**KILLS, "setting": "arena, cold cache"}),
        Result("kills", "chain 1", True, 9.0, "x", {**KILLS, "setting": "arena, cold cache"}),
        Result("kills", "chain 2", False, 9.0, "x", why="the table <b> differs"),
        Result("inputs", "names, 20000", True, 9.0, "x", INPUTS),
        Result("soak", "30 minutes", True, 9.0, "x", {**SOAK, **handles}),
        Result("sharing", "two | arenas", True, 9.0, "x", {"tables": 2}),
    ]
    text = tables(results)
    assert "| arena, cold cache | 10 | 6 | 4 | 0 | 2 | 4 | 0.4 |" in text and "| all | 10 |" in text
    assert "| names | 20,000 | 5,000 | 15,000 | 0 | 7 |" in text
    assert "| 30 minutes | 30.0 | 12,000 | 60,000 | 900.5 | -0.3 | 9 | 2 | 0 | 1 |" in text
    assert "| two \\| arenas | tables 2 | holds |" in text
    assert "* kills, chain 2: the table &lt;b> differs" in text
    assert "Nothing that was tried." in tables(results[3:])
    page = tmp_path / "page.md"
    page.write_text(f"before\n{BEGIN}\nstale\n{END}\nafter\n")
    for _ in range(2):
        write_tables(page, results)
        written = page.read_text()
        assert written.startswith(f"before\n{BEGIN}\n") and written.endswith(f"{END}\nafter\n")
        assert "stale" not in written and written.count("### Kills") == 1
    page.write_text("no marks")
    with pytest.raises(ValueError, match="needs the lines"):
        write_tables(page, results)


def test_whatever_a_case_raises_is_a_result(tmp_path: Path) -> None:
    result = try_case(Case("kills", "a", _crashes), tmp_path / "a", "x")
    assert not result.holds and result.figures == {} and "KeyError" in result.why
