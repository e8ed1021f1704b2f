"""The projected ascent that PGD, BIM and MI-FGSM share: they differ in where it starts and in its momentum."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from agents.attacks.constraint import MAP, Domain
from agents.attacks.targets import Loss

Found = tuple[Float[Tensor, "T m C H W"], Float[Tensor, " T"]]
Search = Callable[[Loss, Float[Tensor, "T m C H W"], Domain], Found]
"""How a δ is looked for: from a loss and a start to each team's best δ in the domain, and its value, by which restarts
are compared."""


@dataclass(frozen=True)
class Steepest:
    """`steps` steps of length `step_size` in the ball's norm, each followed by a projection; the best iterate is kept.

    The defaults are PRBI's (Sec. 11.1). Where only a share of Δ may be used, a step is shorter by as much. `momentum`
    is the decay μ of Dong et al. ("Boosting Adversarial Attacks with Momentum", 2018, Algorithm 1, Eq. 6): gradients of
    unit mean size are summed, older ones weighing less; 0 is the plain gradient.
    """

    steps: int = 15
    step_size: float = 0.1
    momentum: float = 0.0

    def __post_init__(self) -> None:
        check_steps(self.steps, self.step_size)
        if not self.momentum >= 0:
            raise ValueError(f"momentum must be at least 0, got {self.momentum}")

    def __call__(self, loss: Loss, start: Float[Tensor, "T m C H W"], domain: Domain) -> Found:
        """See `Search`."""
        delta = domain.project(start)
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
                delta = domain.project(domain.steepest(direction).mul_(self.step_size).add_(delta))
        return best, best_loss


def better(
    best: Float[Tensor, "T m C H W"], best_value: Float[Tensor, " T"], found: Tensor, value: Tensor
) -> tuple[Float[Tensor, "T m C H W"], Float[Tensor, " T"]]:
    """For each team the δ of the higher value, the first of equals; where all improve, as most steps do, no copy."""
    improved = value > best_value
    if bool(improved.all()):
        return found, value
    return torch.where(improved[:, None, None, None, None], found, best), torch.where(improved, value, best_value)


def check_steps(steps: int, step_size: float) -> None:
    """ValueError for numbers no search can use."""
    if steps < 0 or not step_size > 0:
        raise ValueError(f"ascent needs steps >= 0 and step_size > 0, got {steps} and {step_size}")


def _unit(gradient: Float[Tensor, "T m C H W"]) -> Float[Tensor, "T m C H W"]:
    """Each liar's gradient, of mean absolute value 1; zero where it vanishes."""
    return gradient / gradient.abs().mean(MAP, keepdim=True).clamp(min=torch.finfo(gradient.dtype).tiny)
