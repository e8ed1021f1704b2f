"""The ball is the ball: projection, norms and the rows that perturbations are added to."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from cp_env.perturbation.channel import NORMS, inject, norm_of, project

DELTA = torch.randn(3, 2, 4, 5, 5, generator=torch.Generator().manual_seed(1))


@pytest.mark.parametrize("norm", ["linf", "l2"])
@given(budget=st.floats(0.0, 20.0), scale=st.floats(0.01, 100.0))
def test_projection_lands_in_the_ball_and_is_idempotent(norm: str, budget: float, scale: float) -> None:
    once = project(DELTA * scale, budget, norm)
    assert (norm_of(once, norm) <= budget * (1 + 1e-5) + 1e-7).all()
    torch.testing.assert_close(project(once, budget, norm), once)


@pytest.mark.parametrize("norm", ["linf", "l2"])
def test_projection_leaves_the_inside_alone(norm: str) -> None:
    inside = DELTA * (0.1 / norm_of(DELTA, norm).max())
    assert torch.equal(project(inside, 0.2, norm), inside)


def test_norms_by_hand() -> None:
    delta = torch.zeros(1, 1, 2, 2)
    delta[0, 0, 0, 0], delta[0, 0, 1, 1] = 3.0, -4.0
    assert norm_of(delta, "linf").item() == 4.0
    assert norm_of(delta, "l2").item() == 5.0
    assert project(delta, 1.0, "l2")[0, 0, 1, 1].item() == pytest.approx(-0.8)


def test_perturbations_are_added_to_the_attackers_rows_only() -> None:
    received = torch.zeros(2, 4, 1, 2, 2)
    perturbations = torch.stack([torch.full((2, 1, 2, 2), 1.0), torch.full((2, 1, 2, 2), 2.0)])
    attacked = inject(received, perturbations, torch.tensor([[0, 3], [1, 2]]))
    assert np.array_equal(attacked.amax((2, 3, 4)).numpy(), [[1, 0, 0, 1], [0, 2, 2, 0]])
    assert not received.any()


@pytest.mark.parametrize("norm", NORMS)
def test_balls_of_their_own_sizes_are_projected_onto_as_each_by_itself(norm: str) -> None:
    deltas = torch.randn(3, 2, 4, 4, generator=torch.Generator().manual_seed(0))
    budgets = [0.0, 0.5, 100.0]
    together = project(deltas, torch.tensor(budgets)[:, None, None, None], norm)
    alone = [project(one[None], budget, norm)[0] for one, budget in zip(deltas, budgets, strict=True)]
    assert torch.equal(together, torch.stack(alone))
