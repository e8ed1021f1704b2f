"""Carlini and Wagner's attack: its optimum where it can be written down, and what its two terms trade."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

import agents
from agents.attacks.carlini_wagner import CarliniWagner
from agents.attacks.constraint import FeasibleSet
from cp_env.perturbation.ball import make_ball
from tests.helpers import situations

MODEL = situations.detector()


def _act(situation: Any, **options: Any) -> torch.Tensor:
    attack = agents.make("cw", **options)
    attack.reset(len(situation.active), np.random.default_rng(0))
    return attack.act(situation)


def _loss(situation: Any, delta: torch.Tensor) -> torch.Tensor:
    return situations.value(situation, delta)


def _ball(norm: str) -> FeasibleSet:
    return FeasibleSet(norm, 0.3)


@pytest.mark.parametrize("norm", ["linf", "l2"])
def test_the_optimum_of_a_linear_loss(norm: str) -> None:
    """min ‖δ‖² / M - c g·δ has δ = c g M / 2, M the largest ‖δ‖² in the ball, as long as that is inside."""
    budget, c = 0.3, 2.0
    slope = torch.tensor([[0.5, -1.0, 0.0, 0.25]]).reshape(1, 1, 1, 2, 2)
    largest = budget**2 * (4 if norm == "linf" else 1)
    slope = slope / slope.abs().sum() / (1 if norm == "linf" else 2)
    expected = c * slope * largest / 2
    assert (expected.norm() if norm == "l2" else expected.abs().max()) < budget
    attack = CarliniWagner(steps=250, step_size=0.005, c=c)
    found, _ = attack(lambda delta: (slope * delta).sum((1, 2, 3, 4)), torch.zeros_like(slope), _ball(norm))
    torch.testing.assert_close(found, expected, rtol=0.02, atol=1e-4)


@pytest.mark.parametrize("norm", ["linf", "l2"])
def test_whatever_pulls_it_stays_inside_the_ball(norm: str) -> None:
    attack = CarliniWagner(steps=200, step_size=0.1, c=1e6)
    start = torch.zeros(1, 2, 1, 2, 2)
    found, _ = attack(lambda delta: delta.sum((1, 2, 3, 4)), start, _ball(norm))
    length = found.abs().amax() if norm == "linf" else found.flatten(-3).norm(dim=-1).amax()
    assert 0.29 < length <= 0.3


def test_a_larger_constant_buys_damage_with_size() -> None:
    situation = situations.situation(MODEL, n_worlds=4)
    found = [_act(situation, c=c) for c in (1e-3, 1e-1, 10.0)]
    size = [delta.square().mean().item() for delta in found]
    damage = [_loss(situation, delta).mean().item() for delta in found]
    assert size == sorted(size) and size[2] > 1.5 * size[0]
    assert damage == sorted(damage) and damage[2] > damage[0]


def test_it_starts_at_zero_and_does_damage() -> None:
    situation = situations.situation(MODEL, n_worlds=3)
    assert not _act(situation, steps=0).any()
    noise = agents.make("noise")
    noise.reset(3, np.random.default_rng(0))
    assert (_loss(situation, _act(situation)) > 5 * _loss(situation, noise.act(situation))).all()
    assert not _act(situations.situation(MODEL, budget=0.0)).any()


def test_it_is_smaller_than_bim_at_no_less_than_most_of_its_damage() -> None:
    situation = situations.situation(MODEL, n_worlds=4)
    bim = agents.make("bim")
    bim.reset(4, np.random.default_rng(0))
    theirs, ours = bim.act(situation), _act(situation)
    assert ours.square().mean() < theirs.square().mean()
    assert _loss(situation, ours).mean() > 0.5 * _loss(situation, theirs).mean()


def test_a_constant_that_buys_nothing_is_refused() -> None:
    with pytest.raises(ValueError, match="must be positive, got c=0"):
        agents.make("cw", c=0)


@pytest.mark.parametrize("norm", ["linf", "l2"])
def test_a_random_start_is_where_w_begins(norm: str) -> None:
    """Without steps what is sent is the start; a step later it has moved a little: w was the start's own."""
    situation = situations.situation(MODEL, n_worlds=1, norm=norm)
    start, moved = (_act(situation, random_start=True, steps=steps, step_size=0.003, c=100.0) for steps in (0, 1))
    drawn = make_ball(norm).random(tuple(start.shape[1:]), situation.budget, np.random.default_rng(0).spawn(1)[0])
    torch.testing.assert_close(start[0], drawn, rtol=2e-3, atol=1e-6)
    assert 0 < (moved - start).abs().max() <= 0.004
