"""Sealed defenders: the same verdicts from another process, and nothing but numbers between the two."""

from __future__ import annotations

import gc
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import agents
import defenders
from cp_env.world.scene_cache import SceneBank
from cp_env.world.situation import Outcome
from cp_env.world.verification import DefenderError
from cp_env.world.world import World
from defenders.sealed import SealedDefender, SealedError, seal
from defenders.simulation.world import SimulatedWorld
from tests.helpers.banks import bank, detector

__all__ = ["bank", "detector"]

ROOT = Path(__file__).parents[3]
PLUG_INS = """
import os, sys, time
from defenders import Defender, Query, Verdict

SEEN = []


class Base(Defender):
    def reset(self, n_vehicles, rng):
        self.n = n_vehicles

    def inspect(self, frame):
        yield from ()
        return Verdict(range(self.n))


class Raises(Base):
    def inspect(self, frame):
        yield Query([{0}])
        raise KeyError("my own bug")


class Nothing(Base):
    def inspect(self, frame):
        yield from ()
        return None


class Dies(Base):
    def inspect(self, frame):
        yield Query([{0}])
        os._exit(3)


class Babbles(Base):
    def inspect(self, frame):
        print("a plug-in may print", flush=True)
        for fd in range(3, 20):
            try:
                os.write(fd, b"[" * 2000 + b"\\n")
            except OSError:
                pass
        yield from ()
        return Verdict(range(self.n))


class Guesses(Base):
    def inspect(self, frame):
        yield from ()
        frame.similarity(frame.seen, 3)
        return Verdict(range(self.n))


class Digs(Base):
    def inspect(self, frame):
        yield from ()
        names = set(dir(frame.seen)) | set(vars(frame.seen))
        assert not names & {"detections", "seen", "score_map", "group"}, names
        assert "torch" not in sys.modules and "cp_env.world" not in sys.modules
        return Verdict(range(self.n))


class Sleeps(Base):
    def inspect(self, frame):
        yield Query([{0}])
        time.sleep(600)


class SleepsInReset(Base):
    def reset(self, n_vehicles, rng):
        time.sleep(600)


class Spins(Base):
    def inspect(self, frame):
        yield from ()
        while True:
            pass


class AsksForEver(Base):
    def inspect(self, frame):
        (other,) = yield Query([{0}])
        while True:
            frame.similarity(frame.seen, other)


class Remembers(Base):
    def inspect(self, frame):
        SEEN.append(frame.index)
        yield from ()
        return Verdict({0} if len(SEEN) > 40 else range(self.n))
"""


def play(defender: Any, bank: SceneBank, attack: str = "pgd:steps=1", frames: int = 3) -> list[Outcome]:
    world = World(2, defender=defender, bank=bank, attackers=(1, 3), max_frames=frames)
    world.reset([5, 6])
    made = agents.make(attack)
    made.reset(2, [np.random.default_rng(e) for e in range(2)])
    return [world.step(made.act(world.situation())) for _ in range(frames)]


def told(outcomes: list[Outcome]) -> list[Any]:
    return [(j.verdict, j.groups, j.verifications, j.error) for outcome in outcomes for j in outcome.judgements]


@pytest.mark.parametrize("name", defenders.names())
def test_every_shipped_defender_is_the_same_when_it_is_sealed(name: str, bank: SceneBank) -> None:
    open_handed, sealed = play(defenders.make(name), bank), play(seal(name), bank)
    assert told(sealed) == told(open_handed)
    assert any(j.groups for outcome in sealed for j in outcome.judgements) or name in ("none", "ego_only", "oracle")


def test_a_simulation_of_a_sealed_defender_is_that_of_the_open_one(bank: SceneBank) -> None:
    """`framing` simulates copies of the defender with generators of its own."""
    assert told(play(seal("robosac"), bank, "framing:steps=1,draws=1")) == told(
        play(defenders.make("robosac"), bank, "framing:steps=1,draws=1")
    )


@pytest.fixture
def plug_ins(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    (tmp_path / "sealed_plug_ins.py").write_text(PLUG_INS)
    monkeypatch.syspath_prepend(str(tmp_path))
    yield
    sys.modules.pop("sealed_plug_ins", None)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("Raises", "KeyError: 'my own bug'"),
        ("Nothing", "must return a Verdict, not NoneType"),
        ("Dies", "its process ended"),
        ("Babbles", "does not answer"),
        ("Guesses", "similarity compares two views"),
    ],
)
def test_a_hostile_defender_ends_its_own_episode(plug_ins: None, bank: SceneBank, name: str, message: str) -> None:
    outcome = play(seal(f"sealed_plug_ins:{name}"), bank, frames=1)[0]
    assert outcome.truncated.any()
    assert any(message in (error or "") for error in outcome.errors), outcome.errors


@pytest.mark.parametrize("name", ["Sleeps", "Spins", "AsksForEver"])
def test_one_that_never_answers_ends_its_own_episode(plug_ins: None, bank: SceneBank, name: str) -> None:
    """It fails after its patience, and says so; the world that shares its process fails with it, and play goes on."""
    sealed = seal(f"sealed_plug_ins:{name}", patience=2.0)
    begin = time.monotonic()
    (outcome,) = play(sealed, bank, frames=1)
    assert time.monotonic() - begin < 30
    assert outcome.truncated.all()
    assert all(error is not None and "it has 2 s for an answer" in error for error in outcome.errors)
    assert any("no answer in time" in (error or "") for error in outcome.errors)
    assert sealed._process._pipe.child.poll() is not None


def test_one_that_never_answers_a_reset_is_named(plug_ins: None, bank: SceneBank) -> None:
    with pytest.raises(DefenderError, match=r"failed in reset: it gave no answer in time.*2 s for an answer"):
        play(seal("sealed_plug_ins:SleepsInReset", patience=2.0), bank)


def test_a_sealed_defender_finds_neither_views_nor_the_world(plug_ins: None, bank: SceneBank) -> None:
    assert play(seal("sealed_plug_ins:Digs"), bank)[-1].errors == (None, None)


def test_what_it_remembers_ends_with_its_run(plug_ins: None, bank: SceneBank) -> None:
    """Module-level memory of one run is not there in the next: each is sealed in a process of its own."""
    for _ in range(8):
        outcomes = play(seal("sealed_plug_ins:Remembers"), bank)
        assert all(len(v.collaborators) == 5 for outcome in outcomes for v in outcome.verdicts)


def test_what_cannot_be_made_is_told_as_in_this_process() -> None:
    with pytest.raises(ValueError, match=r"unknown defender 'prib' .did you mean 'prbi'"):
        seal("prib")
    with pytest.raises(ValueError, match="nothing was called"):
        seal("os:abort")


def test_its_process_ends_with_it() -> None:
    sealed = seal("prbi")
    child = sealed._process._pipe.child
    assert child.poll() is None
    del sealed
    gc.collect()
    deadline = time.monotonic() + 10
    while child.poll() is None and time.monotonic() < deadline:
        time.sleep(0.05)
    assert child.poll() is not None


PARENT = """
import sys
import numpy as np
from defenders.sealed import seal
from defenders.simulation.world import SimulatedWorld

sealed = seal("sealed_plug_ins:Spins")
print(sealed._process._pipe.child.pid, flush=True)
sealed.reset(5, np.random.default_rng(0))
SimulatedWorld(5, frozenset({2})).judge(sealed)
"""


@pytest.mark.skipif(not Path("/proc/self/stat").is_file(), reason="looks for the process in /proc")
def test_a_sealed_process_at_work_for_ever_ends_with_its_killed_parent(plug_ins: None, tmp_path: Path) -> None:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), str(tmp_path)])}
    parent = subprocess.Popen([sys.executable, "-c", PARENT], env=environment, stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    child = int(parent.stdout.readline())
    time.sleep(1)  # now it spins
    parent.kill()
    parent.communicate()
    deadline = time.monotonic() + 20
    while Path(f"/proc/{child}").exists() and "State:\tZ" not in Path(f"/proc/{child}/status").read_text():
        assert time.monotonic() < deadline, "it outlives its parent"
        time.sleep(0.05)


def test_views_that_are_no_longer_held_are_let_go() -> None:
    world, sealed = SimulatedWorld(5, frozenset({2})), seal("prbi")
    sealed.reset(5, np.random.default_rng(0))
    held = []
    for _ in range(20):
        world.judge(sealed)
        held.append(len(sealed._process._views))
    assert max(held) < 12


def test_a_view_that_was_not_handed_out_is_no_view() -> None:
    sealed = seal("none")
    with pytest.raises(SealedError, match="does not hold"):
        sealed._process.view(99)
    assert isinstance(sealed, SealedDefender)
    with pytest.raises(TypeError, match="cannot be pickled"):
        sealed.__reduce__()
