from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from cp_env.perturbation.ball import BALLS, make_ball

SHAPE = (2, 3, 4, 5)
norms = st.sampled_from(sorted(BALLS))
budgets = st.floats(1e-3, 1e3)
seeds = st.integers(0, 10_000)


def _norm(name: str, delta: torch.Tensor) -> torch.Tensor:
    return delta.abs().amax((-3, -2, -1)) if name == "linf" else delta.flatten(-3).norm(dim=-1)


def _map(seed: int, scale: float) -> torch.Tensor:
    return torch.randn(SHAPE, generator=torch.Generator().manual_seed(seed)) * scale


@given(norms, budgets, seeds, st.floats(1e-3, 1e3))
def test_projection_ends_inside_and_leaves_what_is_inside(name: str, budget: float, seed: int, scale: float) -> None:
    ball, delta = BALLS[name], _map(seed, scale)
    inside = ball.project(delta, budget)
    assert (_norm(name, inside) <= budget * (1 + 1e-6)).all()
    torch.testing.assert_close(ball.project(inside, budget), inside, rtol=1e-5, atol=0)
    small = delta / _norm(name, delta).amax() * (budget * 0.99)
    torch.testing.assert_close(ball.project(small, budget), small, rtol=1e-6, atol=0)


@given(norms, budgets, seeds)
def test_random_starts_lie_inside_and_differ(name: str, budget: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    first, second = (BALLS[name].random(SHAPE, budget, rng) for _ in range(2))
    assert (_norm(name, first) <= budget * (1 + 1e-6)).all()
    assert first.dtype == torch.float32 and first.shape == SHAPE
    assert not torch.equal(first, second)


@given(norms, seeds)
def test_no_direction_of_unit_norm_climbs_faster(name: str, seed: int) -> None:
    ball, gradient = BALLS[name], _map(seed, 1.0)
    direction = ball.steepest(gradient)
    torch.testing.assert_close(_norm(name, direction), torch.ones(SHAPE[0]))
    other = ball.project(_map(seed + 1, 10.0), 1.0)
    assert ((gradient * direction).sum((-3, -2, -1)) >= (gradient * other).sum((-3, -2, -1)) - 1e-4).all()


@pytest.mark.parametrize("name", sorted(BALLS))
def test_a_zero_gradient_goes_nowhere(name: str) -> None:
    assert torch.equal(BALLS[name].steepest(torch.zeros(SHAPE)), torch.zeros(SHAPE))


def test_an_unknown_norm_lists_the_known_ones() -> None:
    with pytest.raises(ValueError, match=r"l2.*linf.*got 'l1'"):
        make_ball("l1")


@pytest.mark.parametrize("name", sorted(BALLS))
@pytest.mark.parametrize("each", [False, True])
def test_a_given_place_takes_the_projection_and_the_direction(name: str, each: bool) -> None:
    ball, delta = BALLS[name], _map(3, 10.0)
    budget = torch.tensor(0.5) if each else 0.5
    inside, steepest, place = ball.project(delta, budget), ball.steepest(delta), delta.clone()
    assert ball.project(place, budget, out=place) is place and torch.equal(place, inside)
    assert ball.steepest(delta, out=place) is place and torch.equal(place, steepest)
