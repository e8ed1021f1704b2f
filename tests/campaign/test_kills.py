"""The small cut: the chain of kills on a program of a few lines, whole and broken; and the watch for orphans sees one.

`tests/agents/arena/test_cli.py` kills the arena itself once.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from pathlib import Path

import pytest

from tests.campaign import kills, programs
from tests.campaign.case import Fault
from tests.campaign.processes import alive, started

pytestmark = pytest.mark.skipif(not Path("/proc/self/environ").is_file(), reason="finds processes in /proc")

PROGRAM = """
import json, pathlib, subprocess, sys, time
out, broken = pathlib.Path(sys.argv[1]), sys.argv[2] == "broken"
out.mkdir(parents=True, exist_ok=True)
child = [sys.executable, "-c", "import sys; sys.stdin.read()  # spawn_main"]
worker = subprocess.Popen(child, stdin=subprocess.PIPE)
for number in range(20):
    file = out / f"{number}.run"
    if not file.exists():
        time.sleep(0.02)
        file.with_suffix(".part").write_text(str(number))
        file.with_suffix(".part").replace(file)
kept = [int(file.read_text()) for file in out.glob("*.run")]
starts = out / "starts"
starts.write_text(str(int(starts.read_text()) + 1 if starts.exists() else 1))
rows = [{"kept": sorted(kept), "starts": broken and len(list(out.parent.glob("log-*"))) }]
(out / "arena.json").write_text(json.dumps({"rows": rows}))
worker.stdin.close()
worker.wait()
"""


@pytest.fixture
def tiny(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> None:
    """In the place of the arena: twenty short runs, each kept; a broken one counts its starts in the table."""

    def arguments(name: str, out: Path, **options: object) -> list[str]:
        del name, options
        return ["-c", PROGRAM, str(out), request.param]

    monkeypatch.setattr(programs, "arguments", arguments)
    kills.reference.cache_clear()
    kills._kept.cache_clear()


@pytest.mark.parametrize("tiny", ["whole"], indirect=True)
def test_a_killed_program_goes_on_to_the_same_table(tiny: None, tmp_path: Path) -> None:
    found = kills.play(0, 6, 0, tmp_path)
    assert found["kills"] == 6 == found["program"] + found["worker"] and found["program"] > 0
    assert found["compared"] >= 1 and found["setting"] == "arena, cold cache"


@pytest.mark.parametrize("tiny", ["broken"], indirect=True)
def test_a_program_whose_table_depends_on_kills_is_a_fault(tiny: None, tmp_path: Path) -> None:
    with pytest.raises(Fault, match="differs from that of an unkilled run"):
        kills.play(0, 3, 0, tmp_path)


def test_chains_are_seeded_and_cover_every_setting() -> None:
    planned = kills.cases(100, 3)
    assert len(planned) == 20 and len({case.name for case in planned}) == 20
    assert all("5 kills, seed 3" in case.name for case in planned)
    assert [case.name for case in kills.cases(7, 0)] == ["chain 0, 5 kills, seed 0", "chain 1, 2 kills, seed 0"]
    settings = {kills.Setting.of(number) for number in range(20)}
    assert {(s.program, s.cold) for s in settings} == {(p, c) for p in ("arena", "benchmark") for c in (True, False)}
    assert {s.program for s in settings if s.sealed} == {"arena", "benchmark"}


def test_tables_of_a_slow_and_a_fast_machine_are_equal(tmp_path: Path) -> None:
    def table(slow: bool, damage: float) -> object:
        driving = {"milliseconds": 9.0 + slow, "late": {"mean": float(slow)}, "mdr": 0.5}
        row = {"frames_per_second": 7.0 - slow, "damage": damage, "driving": driving}
        found = {"rows": [row], "strata": {"ego_attacker": [row]}, "about": f"slow: {slow}"}
        (tmp_path / "results.json").write_text(json.dumps(found))
        return programs.table("benchmark", tmp_path)

    assert table(slow=True, damage=0.2) == table(slow=False, damage=0.2) != table(slow=False, damage=0.3)


PARENT = """
import subprocess, sys, time
print(subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"]).pid, flush=True)
time.sleep(600)
"""


def test_an_orphan_is_seen_and_ended(tmp_path: Path) -> None:
    with started(["-c", PARENT], tmp_path) as program:
        while not (said := program.said().split()):
            assert not program.ended()
        (child,) = map(int, said)
        assert program.others(sys.executable.rpartition("/")[2]) == [child]
        os.kill(program.process.pid, signal.SIGKILL)
        program.process.wait()
        with pytest.raises(Fault, match=f"orphans after 0 s: {child}: .*time.sleep"):
            program.check_gone(0.2)
    for _ in range(50):  # a killed process is there until its new parent has noticed
        if not alive(child):
            break
        time.sleep(0.1)
    assert not alive(child)


def test_one_that_does_not_end_is_a_fault(tmp_path: Path) -> None:
    with (
        started(["-c", "print('at work', flush=True); import time; time.sleep(600)"], tmp_path) as program,
        pytest.raises(Fault, match="did not end within 2 s: at work"),
    ):
        program.wait(2)
    assert program.ended()
