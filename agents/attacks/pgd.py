"""Projected gradient ascent, shared by PGD, BIM and MI-FGSM: they differ in the start and in the momentum."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from agents.attacks.constraint import FeasibleSet
from agents.attacks.targets import Loss
from cp_env.perturbation.ball import MAP

Optimum = tuple[Float[Tensor, "T m C H W"], Float[Tensor, " T"]]
Optimizer = Callable[[Loss, Float[Tensor, "T m C H W"], FeasibleSet], Optimum]
"""A search for δ: from a loss and a start to each team's best δ in the feasible set and its value, by which restarts
are compared."""


@dataclass(frozen=True)
class ProjectedGradient:
    """`steps` steps of length `step_size` in the ball's norm, each followed by a projection; the best iterate is kept.

    The defaults are PRBI's (Sec. 11.1). Where only a share of Δ may be used, a step is shorter by as much.

    Args:
        steps: of the ascent.
        step_size: length of a step in the ball's norm.
        momentum: the decay μ of Dong et al. ("Boosting Adversarial Attacks with Momentum", 2018, Algorithm 1, Eq. 6):
            gradients of unit mean size are summed, older ones weighing less; 0 is the plain gradient.
    """

    steps: int = 15
    step_size: float = 0.1
    momentum: float = 0.0

    def __post_init__(self) -> None:
        check_steps(self.steps, self.step_size)
        if not self.momentum >= 0:
            raise ValueError(f"momentum must be at least 0, got {self.momentum}")

    def __call__(self, loss: Loss, start: Float[Tensor, "T m C H W"], feasible: FeasibleSet) -> Optimum:
        """See `Optimizer`."""
        delta = feasible.project(start)
        best, best_loss = delta, torch.full((len(start),), -torch.inf, device=start.device)
        velocity = torch.zeros_like(delta) if self.momentum else None
        for step in range(self.steps + 1):
            leaf = delta.detach().requires_grad_(step < self.steps)
            value = loss(leaf)
            best, best_loss = better(best, best_loss, leaf.detach(), value.detach())
            if step < self.steps:
                (direction,) = torch.autograd.grad(value.sum(), leaf)
                if velocity is not None:
                    direction = velocity = self.momentum * velocity + _unit(direction)
                delta = feasible.ascend(delta, direction, self.step_size)
        return best, best_loss


def better(
    best: Float[Tensor, "T m C H W"], best_value: Float[Tensor, " T"], candidate: Tensor, value: Tensor
) -> tuple[Float[Tensor, "T m C H W"], Float[Tensor, " T"]]:
    """For each team the δ of the higher value, the first of equals; where all improve, as most steps do, no copy."""
    improved = value > best_value
    if bool(improved.all()):
        return candidate, value
    return torch.where(improved[:, None, None, None, None], candidate, best), torch.where(improved, value, best_value)


def check_steps(steps: int, step_size: float) -> None:
    """Raise ValueError for steps that no optimizer can use."""
    if steps < 0 or not step_size > 0:
        raise ValueError(f"ascent needs steps >= 0 and step_size > 0, got {steps} and {step_size}")


def _unit(gradient: Float[Tensor, "T m C H W"]) -> Float[Tensor, "T m C H W"]:
    """Each attacker's gradient, of mean absolute value 1; zero where it vanishes."""
    return gradient / gradient.abs().mean(MAP, keepdim=True).clamp(min=torch.finfo(gradient.dtype).tiny)
