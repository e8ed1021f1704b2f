from __future__ import annotations

import math

import pytest
import torch

from cp_env.detector import Dense
from cp_env.perturbation.objective import MARGIN, REACH, STILL, adversarial_loss

PARTS = ("hide", "spoof", "drift")


def _dense(logits: torch.Tensor, shift: float = 0.0) -> Dense:
    return Dense(logits, torch.full((len(logits), 6, *logits.shape[1:]), shift))


def _street() -> torch.Tensor:
    """Two vehicles, at (10, 10) and (20, 20), in an otherwise empty map of 32 x 32 cells."""
    logits = torch.full((1, 32, 32), -6.0)
    logits[0, 10, 10] = logits[0, 20, 20] = 4.0
    return logits


def _only(part: str) -> dict[str, float]:
    return {name: float(name == part) for name in PARTS}


@pytest.mark.parametrize("part", PARTS)
def test_nothing_changed_is_no_loss(part: str) -> None:
    clean = _dense(torch.randn(3, 32, 32, generator=torch.Generator().manual_seed(1)) * 3)
    assert adversarial_loss(clean, clean, **_only(part)).abs().max() < 1e-5


def test_hiding_one_of_two_counts_half_the_fall_of_its_logit_up_to_the_margin() -> None:
    clean, attacked = _street(), _street()
    attacked[0, 10, 10] = -1.0
    loss = adversarial_loss(_dense(attacked), _dense(clean), **_only("hide"))
    assert loss.item() == pytest.approx((4.0 + 1.0) / 2, rel=1e-5)
    attacked[0, 10, 10] = -50.0
    loss = adversarial_loss(_dense(attacked), _dense(clean), **_only("hide"))
    assert loss.item() == pytest.approx((4.0 + MARGIN) / 2, rel=1e-5)


def test_a_ghost_counts_once_a_block_up_to_the_margin() -> None:
    clean, attacked = _street(), _street()
    attacked[0, 1, 1] = 50.0
    objects = 2 * torch.tensor(4.0).sigmoid().item()
    before = math.log1p(16 * math.exp(-6.0))
    expected = (math.log1p(math.exp(MARGIN)) - before) / objects
    assert adversarial_loss(_dense(attacked), _dense(clean), **_only("spoof")).item() == pytest.approx(
        expected, rel=1e-4
    )
    attacked[0, 2, 2] = 50.0  # the same block
    assert adversarial_loss(_dense(attacked), _dense(clean), **_only("spoof")).item() == pytest.approx(
        expected, rel=1e-4
    )
    attacked[0, 2, 5] = 50.0  # the next one
    assert adversarial_loss(_dense(attacked), _dense(clean), **_only("spoof")).item() == pytest.approx(
        2 * expected, rel=1e-4
    )


def test_drift_is_the_mean_l1_on_object_cells_up_to_its_reach() -> None:
    clean = _dense(_street())
    assert adversarial_loss(_dense(_street(), 0.5), clean, **_only("drift")).item() == pytest.approx(0.5)
    assert adversarial_loss(_dense(_street(), 9.0), clean, **_only("drift")).item() == pytest.approx(REACH)


def test_rounding_moves_no_box_and_pulls_nowhere() -> None:
    clean, boxes = _street(), torch.full((1, 6, 32, 32), STILL / 2, requires_grad=True)
    loss = adversarial_loss(Dense(clean, boxes), _dense(clean), **_only("drift"))
    (gradient,) = torch.autograd.grad(loss.sum(), boxes)
    assert loss == 0 and not gradient.any()


def test_a_promising_background_cell_pulls_harder_than_an_easy_one() -> None:
    clean = _street()
    clean[0, 3, 3] = -2.0
    leaf = clean.clone().requires_grad_()
    adversarial_loss(_dense(leaf), _dense(clean), **_only("spoof")).sum().backward()
    assert leaf.grad is not None
    assert leaf.grad[0, 3, 3] > 20 * leaf.grad[0, 30, 3] > 0
    assert leaf.grad[0, 10, 10] == 0 and leaf.grad[0, 10, 11] == 0  # on and beside an object


def test_the_place_weighs_every_part() -> None:
    clean, attacked = _street(), _street()
    attacked[0, 10, 10], attacked[0, 1, 1], attacked[0, 20, 20], attacked[0, 30, 30] = -2.0, 3.0, -2.0, 3.0
    near = torch.zeros(1, 32, 32)
    near[:, :16] = 1
    far = 1 - near
    for part in PARTS:
        of = [
            adversarial_loss(_dense(attacked, 0.3), _dense(clean), where=w, **_only(part))
            for w in (near, far, near + far)
        ]
        assert (of[0] + of[1]).item() == pytest.approx(of[2].item(), rel=1e-5)
        assert of[0].item() == pytest.approx(of[1].item(), rel=1e-5)


def test_weights_of_a_view_are_its_own() -> None:
    clean = _street().repeat(2, 1, 1)
    attacked = clean.clone()
    attacked[:, 10, 10], attacked[:, 1, 1] = -2.0, 3.0
    both = adversarial_loss(
        _dense(attacked), _dense(clean), hide=torch.tensor([1.0, 0.0]), spoof=torch.tensor([0.0, 1.0])
    )
    assert both[0] == adversarial_loss(_dense(attacked[:1]), _dense(clean[:1]), **_only("hide"))
    assert both[1] == adversarial_loss(_dense(attacked[:1]), _dense(clean[:1]), **_only("spoof"))


def test_an_empty_street_gives_a_finite_loss_and_gradient() -> None:
    clean = torch.full((1, 32, 32), -8.0)
    leaf = clean.clone().requires_grad_()
    loss = adversarial_loss(_dense(leaf), _dense(clean))
    loss.sum().backward()
    assert leaf.grad is not None and torch.isfinite(loss).all() and torch.isfinite(leaf.grad).all()
    assert (leaf.grad > 0).all()
