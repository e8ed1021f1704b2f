"""Options of the gradient attack (target groups, budget schedule, cells, joint) against what each must give."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

import agents
from agents.attacks.gradient import GradientAttack
from agents.attacks.objectives.untargeted import UntargetedObjective
from agents.attacks.pgd import ProjectedGradient
from agents.attacks.targets import attack_loss, collect_targets, everyone
from cp_env.perturbation.channel import norm_of
from cp_env.world.situation import Situation
from tests.helpers import situations

MODEL = situations.detector()
OPTIMIZERS = ("pgd", "bim", "mi_fgsm", "cw")
NORMS = {"linf": 0.3, "l2": 3.0}


def _act(name: str, situation: Situation, **options: Any) -> torch.Tensor:
    attack = agents.make(name, **options)
    attack.reset(len(situation.active), np.random.default_rng(0))
    return attack.act(situation)


def _pairs(situation: Situation) -> tuple[torch.Tensor, torch.Tensor]:
    """Two groups a world: one without the last map, one without the first attacker; the second counts three times."""
    worlds, maps = situation.fused.shape
    groups = torch.ones(worlds, 2, maps, dtype=torch.bool)
    groups[:, 0, -1] = False
    groups[torch.arange(worlds), 1, situation.attackers[:, 0]] = False
    return groups, torch.tensor([[1.0, 3.0]]).expand(worlds, -1)


@pytest.mark.parametrize("norm", NORMS)
@pytest.mark.parametrize("name", OPTIMIZERS)
def test_the_budget_schedule_shrinks_the_ball_world_by_world(name: str, norm: str) -> None:
    situation = situations.situation(MODEL, n_worlds=3, frame=np.array([0, 5, 10]), norm=norm, budget=NORMS[norm])
    reached = norm_of(_act(name, situation, budget_schedule=lambda frame: frame / 10, step_size=NORMS[norm] / 2), norm)
    share = reached.amax(1) / NORMS[norm]
    assert share[0] == 0 and 0.05 < share[1] <= 0.5 * (1 + 1e-5) and 0.5 < share[2] <= 1 + 1e-5


def test_a_schedule_beyond_the_budget_is_refused() -> None:
    with pytest.raises(ValueError, match="share of the budget"):
        _act("pgd", situations.situation(MODEL), budget_schedule=lambda frame: 1.0 + 0.0 * frame + 0.5)


@pytest.mark.parametrize("norm", NORMS)
@pytest.mark.parametrize("name", OPTIMIZERS)
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
def test_independent_attackers_each_do_what_they_would_do_alone(name: str) -> None:
    situation = situations.situation(MODEL, n_worlds=3)
    apart = _act(name, situation, joint=False)
    for slot in (0, 1):
        alone = situations.situation(MODEL, n_worlds=3, attackers=situation.attackers[:, slot : slot + 1])
        torch.testing.assert_close(apart[:, slot : slot + 1], _act(name, alone), rtol=0, atol=1e-5)


def test_attackers_that_search_together_do_no_less() -> None:
    situation = situations.situation(MODEL, n_worlds=6, n_attackers=3)
    together, apart = (_act("bim", situation, joint=joint) for joint in (True, False))
    assert situations.value(situation, together).mean() > situations.value(situation, apart).mean()


def test_an_independent_attacker_outside_the_group_pauses() -> None:
    fused = torch.ones(2, 4, dtype=torch.bool)
    situation = situations.situation(MODEL, fused=fused)
    fused[0, situation.attackers[0, 0]] = False
    moved = norm_of(_act("pgd", situation, target_groups="fused", joint=False), "linf") > 0
    assert moved.tolist() == [[False, True], [True, True]]


def test_an_objective_may_use_what_it_knows_of_each_view() -> None:
    """An objective weighted by the size of the group is that weighted sum of the objective itself."""
    situation = situations.situation(MODEL, n_worlds=2)
    delta = _act("noise", situation)

    def sized(targets: Any) -> Any:
        view_loss, size = UntargetedObjective()(targets), targets.groups.sum(1)
        return lambda dense: size * view_loss(dense)

    targets = collect_targets(situation, _pairs, situation.active, joint=True)
    one, three = (situations.value(situation, delta, target_groups=_only(s)) for s in (0, 1))
    torch.testing.assert_close(attack_loss(targets, sized)(delta), 3 * (one + 3 * three), rtol=1e-4, atol=1e-5)


def _only(s: int) -> Any:
    return lambda situation: (_pairs(situation)[0][:, s : s + 1], torch.ones(len(situation.fused), 1))


def test_an_optimizer_of_yours_is_an_argument() -> None:
    situation = situations.situation(MODEL)
    attack = GradientAttack(
        lambda loss, start, feasible: (feasible.project(start + 9.0), loss(start)), random_start=False
    )
    attack.reset(2, np.random.default_rng(0))
    assert (attack.act(situation) == situation.budget).all()
    assert len(collect_targets(situation, everyone, situation.active, joint=False).world) == 4
    assert ProjectedGradient().steps == 15
