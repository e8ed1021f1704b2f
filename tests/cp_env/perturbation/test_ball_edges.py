"""Random starts reach every part of the ball, and a step of ascent goes on from where it stands."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from cp_env.perturbation.ball import BALLS, ascend

SHAPE = (400, 2, 3, 3)


@pytest.mark.parametrize("budget", [0.1, 3.0])
def test_linf_starts_fill_the_cube(budget: float) -> None:
    start = BALLS["linf"].random(SHAPE, budget, np.random.default_rng(0)) / budget
    shares = torch.histc(start, bins=4, min=-1, max=1) / start.numel()
    assert torch.allclose(shares, torch.full((4,), 0.25), atol=0.03)


@pytest.mark.parametrize("budget", [0.1, 3.0])
def test_l2_starts_are_of_every_length_and_in_every_direction(budget: float) -> None:
    start = BALLS["l2"].random(SHAPE, budget, np.random.default_rng(0)) / budget
    shares = torch.histc(start.flatten(1).norm(dim=1), bins=4, min=0, max=1) / len(start)
    assert torch.allclose(shares, torch.full((4,), 0.25), atol=0.1)
    assert (start.mean(0).abs() < 0.05).all()


@pytest.mark.parametrize("name", sorted(BALLS))
@pytest.mark.parametrize("length", [0.01, 1.0, 50.0])
def test_a_step_of_ascent_is_the_nearest_point_to_where_it_leads(name: str, length: float) -> None:
    generator = torch.Generator().manual_seed(0)
    ball, delta = BALLS[name], torch.randn((5, 2, 3, 3), generator=generator)
    delta = ball.project(delta, 0.5)
    direction = ball.steepest(torch.randn(delta.shape, generator=generator))
    before = delta.clone()
    expected = ball.project(before + length * direction, 0.5)
    torch.testing.assert_close(ascend(ball, delta, direction.clone(), length, 0.5), expected)
    assert torch.equal(delta, before)
