"""Rewards against the outcome they are made of."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cp_env.envs.reward import make_reward
from cp_env.types import Detections, View
from cp_env.world.situation import Outcome
from cp_env.world.verification import Judgement
from defenders.protocol import Verdict
from tests.helpers.roads import boxes_at, driving, road

CARS = np.array([[5.0, 0.0, 4.0, 2.0, 0.0], [-9.0, 3.0, 4.0, 2.0, 1.0]])


def view(boxes: np.ndarray) -> View:
    found = Detections(boxes, np.linspace(0.9, 0.5, len(boxes)))
    return View(frozenset({0, 1, 2}), 1, np.zeros(2), found, found, np.zeros((4, 4)))


def outcome(output: np.ndarray, clean: np.ndarray, suspects: set[int], damage: float) -> Outcome:
    """One world in which two cars are there."""
    judgement = Judgement(Verdict({0, 1, 2} - suspects, suspects), view(output), (), 0)
    one, index = np.array([damage], dtype=np.float32), np.array([1])
    return Outcome(
        frame=index,
        seen=(view(output),),
        clean=(view(clean),),
        judgements=(judgement,),
        truth=(CARS,),
        similarity=one,
        damage=one,
        perturbation_norm=np.zeros((1, 1), np.float32),
        attackers=np.array([[2]]),
        truncated=np.array([False]),
    )


def test_the_loss_of_average_precision_by_hand() -> None:
    """Two cars are seen without the attack and one under it: AP falls from 1 to 1/2. A last ghost is free."""
    ap_drop = make_reward("ap_drop")
    assert ap_drop(outcome(CARS[:1], CARS, set(), 0.5)) == pytest.approx([0.5])
    assert ap_drop(outcome(CARS, CARS[:1], set(), 0.5)) == pytest.approx([-0.5]), "the perturbation helped"
    ghost = np.concatenate([CARS, [[20.0, 20.0, 4.0, 2.0, 0.0]]])
    assert ap_drop(outcome(ghost, CARS, set(), 0.3)) == pytest.approx([0.0])
    assert ap_drop(outcome(ghost[::-1], CARS, set(), 0.3)) > 0, "a ghost of the highest score costs precision"


def test_stealth_is_damage_while_nobody_is_flagged() -> None:
    stealth, damage = make_reward("stealth"), make_reward("damage")
    calm, alarmed = (outcome(CARS[:1], CARS, suspects, 0.5) for suspects in (set(), {1}))
    assert stealth(calm) == damage(calm) == 0.5
    assert stealth(alarmed) == 0.0 and damage(alarmed) == 0.5


AHEAD, ABREAST, BEHIND = (14.0, 0.0), (6.0, 3.5), (-20.0, 8.0)


def driven(output: np.ndarray, clean: np.ndarray) -> Outcome:
    """A standing ego, a car 10 m before its bumper that is still coming closer, one abreast it, and one far behind."""
    tracks = [driving(*place, 0, 3) for place in ((0.0, 0.0), ABREAST, BEHIND)]
    scene = road([*tracks, driving(AHEAD[0] + 1, 0, 5, 3, yaw=np.pi)])
    return replace(outcome(output, clean, set(), 0.5), truth=(boxes_at(AHEAD),), traffic=((scene, 1, 32.0),))


def test_critical_is_the_critical_recall_that_is_lost() -> None:
    critical, everything = make_reward("critical"), boxes_at(AHEAD, ABREAST, BEHIND)
    assert critical(driven(boxes_at(ABREAST, BEHIND), everything)) == 1.0, "the one car that comes closer is hidden"
    assert critical(driven(boxes_at(AHEAD), everything)) == 0.0, "what is hidden does not matter"
    assert critical(driven(everything, boxes_at(ABREAST))) == -1.0, "the perturbation shows what was missed"


def test_targeted_is_the_removal_of_the_nearest_or_a_ghost_in_the_way() -> None:
    targeted, everything = make_reward("targeted"), boxes_at(AHEAD, ABREAST)
    assert targeted(driven(boxes_at(ABREAST), everything)) == 1.0
    assert targeted(driven(boxes_at(AHEAD), everything)) == 0.0
    assert targeted(driven(boxes_at(AHEAD, ABREAST, (8.0, 0.0)), everything)) == 1.0
    assert targeted(driven(boxes_at(AHEAD, ABREAST, (8.0, 20.0)), everything)) == 0.0


def test_driving_rewards_say_what_an_outcome_made_by_hand_lacks() -> None:
    with pytest.raises(ValueError, match="traffic"):
        make_reward("critical")(outcome(CARS, CARS, set(), 0.0))


def test_a_callable_is_taken_as_it_is_and_an_unknown_name_is_refused() -> None:
    def own(outcome: Any) -> Any:
        return -outcome.damage

    assert make_reward(own)(replace(outcome(CARS, CARS, set(), 0.25))) == -0.25
    with pytest.raises(ValueError, match="damage, ap_drop, stealth, critical, targeted"):
        make_reward("loss")
