"""The standard detection loss as an objective: a small case by hand, its gradient, and the attacks that maximise it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

import agents
from agents.attacks.objectives.detection import DetectionLoss, unattacked_targets
from agents.attacks.targets import AttackTargets, collect_targets, everyone
from cp_env.detector import Dense
from cp_env.world.situation import Situation
from tests.helpers import situations

MODEL = situations.detector()
CELL = 2.0  # m: the small detector has 32 cells on 64 m
SURE, EMPTY = 4.0, -6.0  # logits


def street(*cells: tuple[int, int], worlds: int = 1) -> Situation:
    """Cars of 4 m by 2 m at the centres of these cells (row, column), in otherwise empty views."""
    logits, boxes = torch.full((worlds, 32, 32), EMPTY), torch.zeros(worlds, 6, 32, 32)
    boxes[:, 2], boxes[:, 3], boxes[:, 5] = np.log(4.0), np.log(2.0), 1.0
    for row, column in cells:
        logits[:, row, column] = SURE
    return replace(situations.situation(MODEL, n_worlds=worlds), perceive_clean=lambda: Dense(logits, boxes))


def targets(situation: Situation) -> AttackTargets:
    return collect_targets(situation, everyone, situation.active, joint=True)


def value(situation: Situation, dense: Dense, **weights: float) -> float:
    return DetectionLoss(**weights)(targets(situation))(dense).item()


def test_one_car_by_hand() -> None:
    """Focal loss (1 - p)² (-log p) of the car's cell and (1 - h)⁴ p² (-log(1 - p)) of the others, h = exp(-d² / 2), and
    twice the smooth L1 of the eight cells round it, whose boxes lie 2 m from the car: 1.975 in x, in y, or in both."""
    situation = street((10, 10))
    p, q = 1 / (1 + np.exp(-SURE)), 1 / (1 + np.exp(-EMPTY))
    row, column = np.mgrid[:32, :32]
    heat = np.exp(-(CELL**2) * ((row - 10) ** 2 + (column - 10) ** 2) / 2)
    others = (row != 10) | (column != 10)
    focal = (1 - p) ** 2 * -np.log(p) + ((1 - heat) ** 4 * q**2 * -np.log(1 - q))[others].sum()
    near, diagonal = np.exp(-2.0), np.exp(-4.0)
    boxes = (4 * near * 1.975 + 4 * diagonal * 2 * 1.975) / (1 + 4 * near + 4 * diagonal)
    assert value(situation, situation.clean) == pytest.approx(focal + 2 * boxes, rel=1e-5)
    assert value(situation, situation.clean, regression=0.0) == pytest.approx(focal, rel=1e-5)
    assert value(situation, situation.clean, classification=0.0) == pytest.approx(2 * boxes, rel=1e-5)


def test_hiding_planting_and_moving_all_pay() -> None:
    situation = street((10, 10), (20, 20))
    clean = situation.clean
    hidden, ghost, moved = clean.logits.clone(), clean.logits.clone(), clean.boxes.clone()
    hidden[0, 10, 10], ghost[0, 5, 25] = EMPTY, SURE
    moved[0, 0, 10, 10] += 0.5
    least = value(situation, clean)
    assert all(value(situation, Dense(logits, clean.boxes)) > least + 1 for logits in (hidden, ghost))
    assert value(situation, Dense(clean.logits, moved)) > least
    assert value(situation, Dense(clean.logits, moved), regression=0.0) == value(situation, clean, regression=0.0)


def test_a_ghost_has_no_margin() -> None:
    """`both` stops counting a logit 3 beyond the middle; this loss does not."""
    situation, values = street((10, 10)), []
    for logit in (3.0, 6.0, 9.0):
        logits = situation.clean.logits.clone()
        logits[0, 5, 25] = logit
        values.append(value(situation, Dense(logits, situation.clean.boxes)))
    assert values[2] - values[1] == pytest.approx(3.0, abs=0.1)


def test_an_empty_view_has_a_loss() -> None:
    situation = street()
    assert 0 < value(situation, situation.clean) < value(situation, street((3, 3)).clean)


def test_views_do_not_touch_each_other() -> None:
    """The training loss is an average over its batch; the objective is each view's own."""
    situation = street((10, 10), worlds=3)
    drawn = torch.Generator().manual_seed(0)
    logits = situation.clean.logits + torch.randn(3, 32, 32, generator=drawn)
    boxes = situation.clean.boxes + torch.randn(3, 6, 32, 32, generator=drawn)
    together = DetectionLoss()(targets(situation))(Dense(logits, boxes))
    alone = [value(street((10, 10)), Dense(logits[b, None], boxes[b, None])) for b in range(3)]
    assert together.tolist() == alone


@pytest.mark.parametrize("weights", [{}, {"classification": 0.5}, {"regression": 0.0}])
def test_gradient_against_finite_differences(weights: dict[str, float]) -> None:
    situation = street((10, 10), (12, 20))
    loss = DetectionLoss(**weights)(targets(situation))
    drawn = torch.Generator().manual_seed(1)
    shape, step = (7, 32, 32), 1e-5
    start = torch.cat([situation.clean.logits[:, None], situation.clean.boxes], 1)[0].double()
    start = (start + 0.3 * torch.randn(shape, generator=drawn).double()).requires_grad_()

    def at(x: torch.Tensor) -> torch.Tensor:
        return loss(Dense(x[None, 0], x[None, 1:])).sum()

    (gradient,) = torch.autograd.grad(at(start), start)
    for _ in range(5):
        direction = torch.randn(shape, generator=drawn).double()
        ahead, behind = at(start.detach() + step * direction), at(start.detach() - step * direction)
        assert ((ahead - behind) / (2 * step)).item() == pytest.approx((gradient * direction).sum().item(), rel=1e-4)


@pytest.mark.parametrize("name", ["pgd", "bim", "cw"])
def test_attacks_maximise_it(name: str) -> None:
    situation = situations.situation(MODEL, n_worlds=2)
    objective = DetectionLoss()
    attack = agents.make(f"{name}:objective=detection_loss", steps=4)
    attack.reset(2, [np.random.default_rng(e) for e in range(2)])
    delta = attack.act(situation)
    assert delta.abs().max() <= situation.budget
    before, after = (situations.value(situation, d, objective) for d in (torch.zeros_like(delta), delta))
    assert (after > before).all()


def test_targets_are_the_boxes_that_the_ego_acts_on() -> None:
    (drawn,) = unattacked_targets(street((10, 10), (20, 21)))
    assert (drawn.heat == 1).nonzero().tolist() == [[0, 10, 10], [0, 20, 21]]
    assert drawn.boxes[0, :, 10, 10].tolist() == pytest.approx([0, 0, np.log(4), np.log(2), 0, 1], abs=1e-6)


@pytest.mark.parametrize("weights", [(-1.0, 1.0), (0.0, 0.0), (float("nan"), 1.0)])
def test_impossible_weights_are_refused(weights: tuple[float, float]) -> None:
    with pytest.raises(ValueError, match="at least 0 and not both 0"):
        DetectionLoss(*weights)


def test_weights_in_a_spec() -> None:
    attack = agents.make("pgd:objective=detection_loss@1:0")
    assert attack.objective == "detection_loss@1:0"  # type: ignore[attr-defined]
    with pytest.raises(ValueError, match="does not take these numbers"):
        agents.make("pgd:objective=detection_loss@1:0:3")
