"""`CachedAttack` answers as its attack would, and computes every answer once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

import agents
from agents.attacks.cached import CachedAttack
from agents.protocol import Attack
from cp_env.world.situation import Situation
from tests.helpers.situations import detector, situation

MODEL = detector()
STORY = [replace(situation(MODEL, first=2 * t), frame=np.full(2, t)) for t in range(4)]


def play(attack: Attack, story: list[Situation], seed: int = 0) -> list[torch.Tensor]:
    attack.reset(2, np.random.default_rng(seed))
    return [attack.act(frame) for frame in story]


def same(a: list[torch.Tensor], b: list[torch.Tensor]) -> bool:
    return all(torch.equal(x, y) for x, y in zip(a, b, strict=True))


@pytest.mark.parametrize("name", ["pgd", "bim", "cw", "noise"])
def test_it_is_the_attack(name: str) -> None:
    """Once and again, and where a longer episode goes on from what is cached."""
    plain = play(agents.make(name, **({} if name == "noise" else {"steps": 2})), STORY)
    cached = CachedAttack(agents.make(name, **({} if name == "noise" else {"steps": 2})))
    assert same(play(cached, STORY[:2]), plain[:2]) and cached.computed == 2
    assert same(play(cached, STORY), plain) and cached.computed == 4
    for answer in play(cached, STORY):
        answer.zero_()  # the caller's own
    assert same(play(cached, STORY), plain) and cached.computed == 4


@pytest.mark.parametrize(
    "other",
    [
        {"budget": 0.2},
        {"norm": "l2"},
        {"frame": np.array([3, 4])},
        {"active": torch.tensor([True, False])},
        {"detector": detector(1)},
        {"receive": STORY[1].receive},
        {"attackers": STORY[0].attackers.flip(1)},
    ],
    ids=lambda other: next(iter(other)),
)
def test_another_situation_is_another_question(other: dict[str, object]) -> None:
    cached = CachedAttack(agents.make("pgd", steps=1))
    play(cached, STORY[:1])
    changed = [replace(STORY[0], **other)]
    assert same(play(cached, changed), play(agents.make("pgd", steps=1), changed)) and cached.computed == 2


def test_so_are_other_random_numbers_and_another_past() -> None:
    cached = CachedAttack(agents.make("pgd", steps=1))
    first = play(cached, STORY[:1])
    assert not same(play(cached, STORY[:1], seed=1), first)
    play(cached, [STORY[1], STORY[0]])
    assert cached.computed == 4


def test_nothing_of_the_defence_is_shown() -> None:
    class Curious:
        """Attacks by what it sees of the defence."""

        def reset(self, n_worlds: int, rng: object) -> None: ...

        def act(self, situation: Situation) -> torch.Tensor:
            assert situation.fused.all() and situation.output == situation.verdict == (None, None)
            with pytest.raises(ValueError, match="knows of no defence"):
                situation.simulate(torch.zeros(2, 2, 8, 16, 16), [])
            return torch.ones(2, 2, 8, 16, 16)

    left_out = torch.tensor([[True, False, True, False]] * 2)
    cached = CachedAttack(Curious())
    play(cached, [replace(STORY[0], fused=left_out)])
    play(cached, STORY[:1])
    assert cached.computed == 1


def test_it_forgets_the_oldest() -> None:
    cached = CachedAttack(agents.make("noise"), frames=2)
    for _ in range(2):
        play(cached, STORY[:3])
    assert cached.computed == 6 and len(cached._cache) == 2
