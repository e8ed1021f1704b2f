"""The holes of the ascent: whose views, how much, where, together or alone; each against what it must come to."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

import agents
from agents.attacks.gradient import Ascent
from agents.attacks.objectives.untargeted import Objective
from agents.attacks.pgd import Steepest
from agents.attacks.targets import attack_loss, everyone, survey
from cp_env.perturbation.channel import norm_of
from cp_env.world.situation import Situation
from tests.helpers import situations

MODEL = situations.detector()
SEARCHES = ("pgd", "bim", "mi_fgsm", "cw")
NORMS = {"linf": 0.3, "l2": 3.0}


def _act(name: str, situation: Situation, **knobs: Any) -> torch.Tensor:
    attacker = agents.make(name, **knobs)
    attacker.reset(len(situation.active), np.random.default_rng(0))
    return attacker.act(situation)


def _pairs(situation: Situation) -> tuple[torch.Tensor, torch.Tensor]:
    """Two groups a world: one without the last map, and one without the first liar; the second counts three times."""
    worlds, maps = situation.fused.shape
    groups = torch.ones(worlds, 2, maps, dtype=torch.bool)
    groups[:, 0, -1] = False
    groups[torch.arange(worlds), 1, situation.attackers[:, 0]] = False
    return groups, torch.tensor([[1.0, 3.0]]).expand(worlds, -1)


def test_the_loss_is_the_weighted_sum_over_the_groups() -> None:
    situation = situations.situation(MODEL, n_worlds=3)
    groups, _ = _pairs(situation)
    delta = _act("noise", situation)
    whole = situations.value(situation, delta, audience=_pairs)
    parts = [situations.value(situation, delta, audience=situations.groups_of(groups[:, s])) for s in (0, 1)]
    torch.testing.assert_close(whole, parts[0] + 3 * parts[1], rtol=1e-4, atol=1e-5)


def test_an_attack_in_expectation_is_better_in_expectation() -> None:
    situation = situations.situation(MODEL, n_worlds=4)
    blunt, told = _act("bim", situation), _act("bim", situation, audience=_pairs)
    value = [situations.value(situation, delta, audience=_pairs).mean() for delta in (blunt, told)]
    assert value[1] > value[0]


def test_a_group_of_no_weight_and_one_without_liars_are_left_out() -> None:
    situation = situations.situation(MODEL, n_worlds=2)
    groups = torch.ones(2, 3, 4, dtype=torch.bool)
    groups[:, 1].scatter_(1, situation.attackers, False)
    groups[:, 2] = False  # a filler, which must not be looked at
    weights = torch.tensor([[1.0, 5.0, 0.0]]).expand(2, -1)
    views = survey(situation, lambda _: (groups, weights), situation.active, joint=True)
    assert views.team.tolist() == [0, 1] and views.groups.all() and views.weight.tolist() == [1.0, 1.0]


@pytest.mark.parametrize(
    "crowd",
    [
        (torch.ones(2, 4, dtype=torch.bool), torch.ones(2, 4)),
        (torch.ones(2, 1, 4, dtype=torch.bool), torch.ones(2, 2)),
        (torch.ones(2, 1, 4), torch.ones(2, 1)),
        (torch.ones(2, 1, 4, dtype=torch.bool), -torch.ones(2, 1)),
    ],
)
def test_a_crowd_that_cannot_be_is_refused(crowd: Any) -> None:
    with pytest.raises(ValueError, match="an audience gives"):
        _act("bim", situations.situation(MODEL), audience=lambda _: crowd)


@pytest.mark.parametrize("norm", NORMS)
@pytest.mark.parametrize("name", SEARCHES)
def test_the_allowance_shrinks_the_ball_world_by_world(name: str, norm: str) -> None:
    situation = situations.situation(MODEL, n_worlds=3, frame=np.array([0, 5, 10]), norm=norm, budget=NORMS[norm])
    reached = norm_of(_act(name, situation, allowance=lambda frame: frame / 10, step_size=NORMS[norm] / 2), norm)
    share = reached.amax(1) / NORMS[norm]
    assert share[0] == 0 and 0.05 < share[1] <= 0.5 * (1 + 1e-5) and 0.5 < share[2] <= 1 + 1e-5


def test_an_allowance_beyond_the_budget_is_refused() -> None:
    with pytest.raises(ValueError, match="share of the budget"):
        _act("pgd", situations.situation(MODEL), allowance=lambda frame: 1.0 + 0.0 * frame + 0.5)


@pytest.mark.parametrize("norm", NORMS)
@pytest.mark.parametrize("name", SEARCHES)
def test_nothing_is_sent_from_cells_that_are_closed(name: str, norm: str) -> None:
    situation = situations.situation(MODEL, norm=norm, budget=NORMS[norm])
    cells = torch.zeros(2, 2, situations.SIZE, situations.SIZE, dtype=torch.bool)
    cells[0, :, :8] = cells[1, :, :, 8:] = True
    delta = _act(name, situation, where=lambda _: cells, step_size=NORMS[norm] / 3)
    touched = delta.abs().amax(2) > 0
    assert not (touched & ~cells).any() and touched.flatten(2).any(2).all()
    assert (norm_of(delta, norm) <= NORMS[norm] * (1 + 1e-5)).all()
    assert (situations.value(situation, delta) > 0).all()


def test_cells_of_another_shape_are_refused() -> None:
    with pytest.raises(ValueError, match=r"\[E, k, H, W\] = \(2, 2, 16, 16\)"):
        _act("bim", situations.situation(MODEL), where=lambda _: torch.ones(2, 16, 16))


@pytest.mark.parametrize("name", ["bim", "cw"])
def test_independent_liars_each_do_what_they_would_do_alone(name: str) -> None:
    situation = situations.situation(MODEL, n_worlds=3)
    apart = _act(name, situation, joint=False)
    for slot in (0, 1):
        alone = situations.situation(MODEL, n_worlds=3, attackers=situation.attackers[:, slot : slot + 1])
        torch.testing.assert_close(apart[:, slot : slot + 1], _act(name, alone), rtol=0, atol=1e-5)


def test_liars_who_search_together_do_no_less() -> None:
    situation = situations.situation(MODEL, n_worlds=6, n_liars=3)
    together, apart = (_act("bim", situation, joint=joint) for joint in (True, False))
    assert situations.value(situation, together).mean() > situations.value(situation, apart).mean()


def test_an_independent_liar_outside_the_group_pauses() -> None:
    fused = torch.ones(2, 4, dtype=torch.bool)
    situation = situations.situation(MODEL, fused=fused)
    fused[0, situation.attackers[0, 0]] = False
    moved = norm_of(_act("pgd", situation, audience="fused", joint=False), "linf") > 0
    assert moved.tolist() == [[False, True], [True, True]]


def test_a_goal_may_use_what_it_knows_of_each_view() -> None:
    """A goal weighted by the size of the group is that weighted sum of the goal itself."""
    situation = situations.situation(MODEL, n_worlds=2)
    delta = _act("noise", situation)

    def sized(views: Any) -> Any:
        score, size = Objective()(views), views.groups.sum(1)
        return lambda dense: size * score(dense)

    views = survey(situation, _pairs, situation.active, joint=True)
    one, three = (situations.value(situation, delta, audience=_only(s)) for s in (0, 1))
    torch.testing.assert_close(attack_loss(views, sized)(delta), 3 * (one + 3 * three), rtol=1e-4, atol=1e-5)


def _only(s: int) -> Any:
    return lambda situation: (_pairs(situation)[0][:, s : s + 1], torch.ones(len(situation.fused), 1))


def test_a_search_of_yours_is_an_argument() -> None:
    situation = situations.situation(MODEL)
    attacker = Ascent(lambda loss, start, domain: (domain.project(start + 9.0), loss(start)), random_start=False)
    attacker.reset(2, np.random.default_rng(0))
    assert (attacker.act(situation) == situation.budget).all()
    assert len(survey(situation, everyone, situation.active, joint=False).world) == 4
    assert Steepest().steps == 15
