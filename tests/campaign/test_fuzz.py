"""The small cut: some inputs of every family in this process; and a fault of every kind is seen by the watch."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

import pytest

from tests.campaign import fuzz
from tests.campaign.case import Fault
from tests.campaign.inputs import worker
from tests.campaign.inputs.families import FAMILIES
from tests.campaign.inputs.trial import Family, Try
from tests.campaign.values import STRANGE, strange, text

LINUX = pytest.mark.skipif(not Path("/proc/self/statm").is_file(), reason="reads /proc")
COUNTS = {"names": 400, "objects": 150, "settings": 400, "options": 60, "resets": 100, "actions": 100, "files": 150}
SMALL = """
import json, pathlib, sys
import numpy as np
from tests.campaign.inputs import worker
from tests.campaign.inputs.families import FAMILIES
from tests.campaign.inputs.trial import Family

found = {}
families = {**FAMILIES, "big": Family(lambda folder: lambda rng: bool(np.ones(worker.MEMORY // 4)[0]), (), 1.0, 1)}
for name in families:
    folder = pathlib.Path(sys.argv[1]) / name
    folder.mkdir()
    found[name] = worker.run(name, 1, 10**6, json.loads(sys.argv[2]).get(name, 100), folder, families)
(pathlib.Path(sys.argv[1]) / "all").write_text(json.dumps(found))
"""


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, Any]]:
    """What came of some inputs of every family: in a process of its own, whose memory is bounded."""
    folder = tmp_path_factory.mktemp("inputs")
    with fuzz.started(["-c", SMALL, str(folder), json.dumps(COUNTS)], folder) as program:
        assert program.wait(600) == 0, program.said()
    told: dict[str, dict[str, Any]] = json.loads((folder / "all").read_text())
    return told


@LINUX
@pytest.mark.parametrize("name", FAMILIES)
def test_inputs_are_taken_or_refused(name: str, found: dict[str, dict[str, Any]]) -> None:
    assert found[name]["faults"] == []
    assert found[name]["inputs"] == found[name]["taken"] + found[name]["refused"] == COUNTS.get(name, 100)
    assert found[name]["refused"] > 0


@LINUX
def test_memory_beyond_the_bound_is_an_error(found: dict[str, dict[str, Any]]) -> None:
    assert len(found["big"]["faults"]) == worker.FAULTS and "MemoryError" in found["big"]["faults"][0]


def test_shares_add_up_and_chunks_cover_all() -> None:
    assert sum(family.share for family in FAMILIES.values()) == pytest.approx(1.0)
    for inputs in (1_000_000, 12_345):
        planned = fuzz.cases(inputs, 0)
        counts = [int(case.name.split(", ")[1].split()[0]) for case in planned]
        assert sum(counts) == pytest.approx(inputs, abs=len(FAMILIES))
        assert len({case.name for case in planned}) == len(planned)


def test_an_input_depends_on_its_number_alone() -> None:
    assert [text(Random("a-1"), ["b", "c"]) for _ in range(2)] == [text(Random("a-1"), ["b", "c"])] * 2
    kinds = {type(strange(Random(f"a-{number}"))) for number in range(300)}
    assert len(kinds) > 20 and len(STRANGE) > 50


# -- the watch --------------------------------------------------------------------------------------------------------


def _family(one: Try) -> Family:
    return Family(lambda folder: one, (ValueError,), 1.0, 10)


def _refused(rng: Random) -> bool:
    raise ValueError("no")


def _raises(rng: Random) -> bool:
    if rng.random() < 0.5:
        raise KeyError("an error that is not documented")
    return True


@LINUX
def test_an_error_that_is_not_documented_is_named_with_its_input(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(worker, "bound_memory", lambda: None)
    families = {"good": _family(_refused), "bad": _family(_raises)}
    (tmp_path / "good").mkdir()
    (tmp_path / "bad").mkdir()
    good = worker.run("good", 0, 0, 20, tmp_path / "good", families)
    bad = worker.run("bad", 0, 0, 40, tmp_path / "bad", families)
    assert (good["refused"], good["faults"]) == (20, [])
    assert len(bad["faults"]) == worker.FAULTS and bad["inputs"] < 40
    number = int(bad["faults"][0].split()[1])
    with pytest.raises(KeyError):
        _raises(Random(f"0-bad-{number}"))


WORKERS: dict[str, tuple[str, str]] = {
    "crash": ("now(7); os.kill(os.getpid(), 11)", "the worker ended in input 7 of names, seed 0"),
    "hang": ("now(3); now(4); time.sleep(600)", "input 4 of names, seed 0 hangs"),
    "faults": (
        "done(inputs=9, taken=1, refused=7, faults=['input 5 …'], grown_mb=1)",
        "1 errors that are not documented: input 5",
    ),
}
HEAD = """
import json, os, pathlib, struct, sys, time
NOW = struct.Struct("<Q")
folder = pathlib.Path(sys.argv[-1])
def now(number):
    (folder / "part").write_bytes(NOW.pack(number))
    (folder / "part").replace(folder / "now")
    time.sleep(0.2)
def done(**found):
    (folder / "found").write_text(json.dumps(found))
"""


@LINUX
@pytest.mark.parametrize("kind", WORKERS)
def test_a_crash_a_hang_and_a_fault_are_seen(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    body, message = WORKERS[kind]
    (tmp_path / "worker.py").write_text(HEAD + body)
    start: Callable[..., object] = fuzz.started

    def instead(words: list[str], folder: Path, **options: object) -> object:
        return start([str(tmp_path / "worker.py"), *words[4:]], folder, **options)

    monkeypatch.setattr(fuzz, "started", instead)
    monkeypatch.setattr(fuzz, "HANGS", 1.0)
    begin = time.monotonic()
    with pytest.raises(Fault, match=message):
        fuzz.play("names", 0, 0, 9, tmp_path)
    assert time.monotonic() - begin < 60
