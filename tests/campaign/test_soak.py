"""The small cut: seconds of toy worlds; and growth of every kind is seen."""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest

from tests.campaign.case import Fault
from tests.campaign.processes import Program, started
from tests.campaign.soak import HANDLES, Args, Sample, judged, play, soak

pytestmark = pytest.mark.skipif(not Path("/proc/self/statm").is_file(), reason="reads /proc")

FLAT = [Sample(float(t), 16 * t, 80 * t, 500.0 + t % 3, 20, 4, 0, 1) for t in range(1, 101)]


def test_worlds_are_reset_and_sampled() -> None:
    samples = list(itertools.islice(soak(Args(minutes=60, worlds=2, frames=2, scenes="toy", samples=10**9)), 3))
    assert len(samples) == 3
    turns = [(sample.resets - 4) // 4 for sample in samples]  # each resets two worlds of two environments
    assert turns == list(range(turns[0], turns[0] + 3))
    assert [sample.frames for sample in samples] == [turn * 2 * 2 * 2 for turn in turns]
    assert all(sample.memory_mb > 50 and sample.files > 2 and sample.threads > 0 for sample in samples)
    assert len({(sample.files, sample.children) for sample in samples}) == 1


@pytest.mark.parametrize(("given", "last"), [({"resets": 24}, 24), ({"minutes": 1e-9}, 8)])
def test_it_lasts_as_long_as_is_said(given: dict[str, Any], last: int) -> None:
    """The last sample is taken at the end, so that all resets that were asked for are in it."""
    samples = list(soak(Args(worlds=2, frames=2, scenes="toy", samples=2, **given)))
    assert samples[-1].resets == last
    assert len(samples) == (2 if "resets" in given else 1)


def test_too_few_resets_are_a_fault(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Of a soak that ends before its time."""
    monkeypatch.setattr("tests.campaign.soak.started", ended_early)
    with pytest.raises(Fault, match=r"1,600 resets, not 10,000"):
        play(Args(resets=10_000), tmp_path)
    assert play(Args(resets=1_600), tmp_path)["resets"] == 1600


@contextmanager
def ended_early(words: Sequence[str], folder: Path, **options: object) -> Iterator[Program]:
    """In the place of the soak: a process that ends at once, and samples that are flat."""
    (folder / "samples.jsonl").write_text("".join(json.dumps(asdict(sample)) + "\n" for sample in FLAT))
    with started(["-c", "pass"], folder) as program:
        yield program


def test_what_is_flat_holds() -> None:
    found = judged(FLAT)
    assert found["resets"] == 1600 and abs(found["slope_mb_per_hour"]) < 100 and found["memory_mb"] == 501


def test_growth_in_the_first_half_is_warming_up() -> None:
    judged([replace(s, memory_mb=min(s.seconds, 50) * 10, files=min(int(s.seconds), 50)) for s in FLAT])


def test_memory_that_grows_is_a_fault() -> None:
    with pytest.raises(Fault, match=r"memory grew from .* MB an hour"):
        judged([replace(s, memory_mb=500 + s.seconds) for s in FLAT])


@pytest.mark.parametrize("name", HANDLES)
def test_handles_that_grow_are_a_fault(name: str) -> None:
    with pytest.raises(Fault, match=f"{name} grew from"):
        judged([replace(s, **{name: int(s.seconds) // 20}) for s in FLAT])
