"""The attack that has a benign vehicle flagged."""

from __future__ import annotations

import numpy as np
import torch

from agents.attacks.adaptive import framing
from cp_env.world.scene_cache import SceneBank
from cp_env.world.verification import Judgement
from defenders.protocol import Verdict
from tests.helpers import situations
from tests.helpers.attacked_scenes import MODEL, play


def test_framing_gets_its_victim_flagged_more_often_than_pgd_a_benign_vehicle(street: SceneBank) -> None:
    """Eight episodes; over sixteen, seeds 1 to 8, it is 0.69 of the victims against 0.27 of PGD's benign vehicles."""
    framed: list[bool] = []
    for seed in (1, 2, 3, 4):
        attack = framing.Framing(draws=1, steps=5)
        verdicts = play(street, attack, seed=seed)[-1].verdicts
        framed += [victim in v.suspects for victim, v in zip(attack.victims, verdicts, strict=True)]
    assert np.mean(framed) >= 2 / 3
    by_pgd = [
        len(v.suspects - {1, 2}) / 3 for seed in (1, 2, 3, 4) for v in play(street, "pgd", seed=seed)[-1].verdicts
    ]
    assert np.mean(framed) > np.mean(by_pgd) + 0.2


def test_evidence_of_a_verification_is_against_the_vehicle_that_it_would_flag() -> None:
    def judged(*groups: set[int], suspects: tuple[int, ...] = ()) -> Judgement:
        view = situations.simulate(torch.zeros(1), [np.random.default_rng(0)]).judgements[0].output
        return Judgement(Verdict(range(5), suspects), view, tuple(frozenset(g) for g in groups), len(groups))

    attackers = frozenset({1, 2})
    evidence = framing.evidence_against
    assert evidence(3, judged({1, 3}, {0, 2, 4}), frozenset({1}), attackers) == 2  # it fails, and 2 is cleared
    assert evidence(3, judged({1, 4}, {0, 2, 3}), frozenset({1}), attackers) == -2  # the victim is cleared
    assert evidence(3, judged({3}, suspects=(3,)), frozenset({1}), attackers) == 0  # alone, and flagged all the same
    assert evidence(3, judged(suspects=(1,)), frozenset({1}), attackers) == -0.5
    assert framing.subsets(2) == [(0,), (1,), (0, 1)]


def test_the_victim_is_benign_and_stays_the_same() -> None:
    situation = situations.situation(MODEL, attackers=torch.tensor([[1, 2], [0, 3]]))
    attack = framing.Framing(victim=1)
    attack.reset(2, np.random.default_rng(0))
    assert [attack._candidates(situation, e) for e in range(2)] == [[3], [1]]
    attack = framing.Framing()
    attack.reset(2, np.random.default_rng(0))
    assert [attack._candidates(situation, e) for e in range(2)] == [[0, 3], [1, 2]]
    attack.victims = [3, 0]
    assert [attack._candidates(situation, e) for e in range(2)] == [[3], [1, 2]], "0 is malicious in this episode"
