"""The small cut: threads and copies in this process, a vector by fork, and a spoilt cache; differences are seen."""

from __future__ import annotations

from pathlib import Path
from random import Random

import numpy as np
import pytest

from tests.campaign import sharing
from tests.campaign.case import Fault
from tests.helpers.toy_evaluation import toy_bank


def test_threads_play_what_each_plays_alone() -> None:
    sharing.check_threads()


def test_copies_go_on_as_the_original() -> None:
    sharing.check_copies()


@pytest.mark.skipif(not hasattr(__import__("os"), "fork"), reason="forks")
@pytest.mark.parametrize("kind", ["async", "subproc"])
def test_forked_environments_show_what_each_shows_alone(kind: str) -> None:
    toy_bank()  # made before the fork, as a program would
    sharing.check_vector(kind, "fork")


def test_another_seed_is_another_trajectory() -> None:
    one, again, other = (sharing.played(sharing.make_env(), number) for number in (0, 0, 1))
    assert one == again and len(one) == sharing.FRAMES + 1
    assert not set(one) & set(other)
    assert sharing.digest(np.zeros(3), 0.0) != sharing.digest(np.zeros(3), 0.5)


def test_one_bit_is_flipped(tmp_path: Path) -> None:
    file = tmp_path / "a.maps"
    file.write_bytes(bytes(100))
    assert sharing.flip(file, Random(0))
    assert sum(bin(byte).count("1") for byte in file.read_bytes()) == 1
    assert not sharing.flip(tmp_path / "gone", Random(0))


@pytest.mark.skipif(not Path("/proc/self/environ").is_file(), reason="finds processes in /proc")
def test_a_check_that_fails_is_a_fault(tmp_path: Path) -> None:
    with pytest.raises(Fault, match=r"it ended with 1: (.|\n)*no_such_method"):
        sharing.in_a_process("async no_such_method", 1, tmp_path)


def test_every_way_is_a_case() -> None:
    names = [case.name for case in sharing.cases(3)]
    assert len(set(names)) == len(names) == 12
    assert all(name.endswith(", seed 3") for name in names)
