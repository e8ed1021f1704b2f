"""Laws that every registered defender keeps, whatever it is shown."""

from __future__ import annotations

import copy
import hashlib
import pickle
from dataclasses import dataclass
from typing import NoReturn

import numpy as np
import pytest

import defenders
from defenders import Defender, Frame
from defenders.simulation.world import FrameResult, SimulatedWorld

FRAMES = 10
PROTOCOL = {"index", "n_vehicles", "present", "seen", "similarity", "agreement"}


class Guard:
    """A frame that has the protocol's six names and nothing else."""

    def __init__(self, frame: Frame) -> None:
        vars(self).update((name, getattr(frame, name)) for name in PROTOCOL)

    def __getattr__(self, name: str) -> NoReturn:
        raise AssertionError(f"a defender read {name!r}")


@dataclass
class FickleWorld(SimulatedWorld):
    """Similarities drawn from a hash of the views: normal, abnormal and contradictory frames in every order."""

    seed: int = 0

    def similarity(self, a: int, b: int) -> float:
        digest = hashlib.blake2b(f"{self.seed} {min(a, b)} {max(a, b)}".encode(), digest_size=2).digest()
        return int.from_bytes(digest, "big") / 65535

    def show(self, attack: bool) -> Frame:
        return Guard(super().show(attack))  # type: ignore[return-value]


def begin(defender: Defender, n: int, seed: int) -> FickleWorld:
    attackers = frozenset({seed % n})
    if (reveal := getattr(defender, "reveal_attackers", None)) is not None:
        reveal(attackers)
    defender.reset(n, np.random.default_rng(seed))
    return FickleWorld(n, attackers, seed=seed)


def episode(defender: Defender, n: int, seed: int) -> list[FrameResult]:
    world = begin(defender, n, seed)
    return [world.judge(defender) for _ in range(FRAMES)]


@pytest.fixture(params=defenders.names())
def defender(request: pytest.FixtureRequest) -> Defender:
    return defenders.make(request.param)


@pytest.mark.parametrize("n", range(2, 9))
def test_groups_and_verdicts_hold_vehicles_only(defender: Defender, n: int) -> None:
    """Groups and their number are checked by the world as well: QueryError."""
    everyone = frozenset(range(n))
    for seed in range(3):
        for result in episode(defender, n, seed):
            verdict = result.verdict
            assert verdict.collaborators and verdict.collaborators <= everyone
            assert verdict.suspects <= everyone
            assert not verdict.suspects & verdict.collaborators, "no flagged vehicle is fused"
            assert all(group and group <= everyone for group in result.groups)


@pytest.mark.parametrize("n", [2, 5, 8])
def test_vehicles_appear_and_drop_out(defender: Defender, n: int) -> None:
    """A group or a verdict without a present vehicle would be a QueryError."""
    for seed in range(3):
        world = begin(defender, n, seed)
        away = np.random.default_rng(seed).random((FRAMES, n)) < 0.5
        away[:, 0] = False
        world.absent = lambda frame, attackers, away=away: frozenset(np.flatnonzero(away[frame]).tolist())
        for _ in range(FRAMES):
            verdict = world.judge(defender).verdict
            assert not verdict.suspects & verdict.collaborators


@pytest.mark.parametrize("n", [2, 5, 8])
def test_beliefs_are_probabilities(defender: Defender, n: int) -> None:
    world = begin(defender, n, 0)
    for _ in range(FRAMES):
        belief = defender.belief()
        assert belief.shape in ((0,), (n,))
        assert ((belief >= 0) & (belief <= 1)).all()
        world.judge(defender)


@pytest.mark.parametrize("n", [2, 5, 8])
def test_the_same_seed_asks_the_same(defender: Defender, n: int) -> None:
    assert episode(copy.deepcopy(defender), n, 7) == episode(defender, n, 7)


def test_reset_forgets_everything(defender: Defender) -> None:
    fresh = episode(copy.deepcopy(defender), 5, 1)
    episode(defender, 8, 2)
    assert episode(defender, 5, 1) == fresh


def test_state_survives_pickling_between_frames(defender: Defender) -> None:
    expected = episode(copy.deepcopy(defender), 5, 3)
    world = begin(defender, 5, 3)
    for result in expected:
        defender = pickle.loads(pickle.dumps(defender))
        assert world.judge(defender) == result


def test_two_instances_share_nothing(defender: Defender) -> None:
    one, other = defender, defenders.make(copy.deepcopy(defender))
    expected = episode(copy.deepcopy(one), 5, 4), episode(copy.deepcopy(other), 6, 5)
    worlds = begin(one, 5, 4), begin(other, 6, 5)
    results = [(worlds[0].judge(one), worlds[1].judge(other)) for _ in range(FRAMES)]
    assert tuple(map(list, zip(*results, strict=True))) == expected


def test_nobody_touches_the_global_generator(defender: Defender) -> None:
    before = np.random.get_state()[1].copy()  # type: ignore[index, union-attr]  # noqa: NPY002
    episode(defender, 5, 6)
    assert (np.random.get_state()[1] == before).all()  # type: ignore[index]  # noqa: NPY002


def test_the_guard_guards() -> None:
    class Spy(defenders.NoDefence):
        def inspect(self, frame: Frame) -> defenders.Inspection:
            yield from ()
            return defenders.Verdict(frame.attackers)  # type: ignore[attr-defined]

    with pytest.raises(AssertionError, match="attackers"):
        episode(Spy(), 5, 0)
