"""The attack of Carlini and Wagner ("Towards Evaluating the Robustness of Neural Networks", 2017, Secs. V, VI) on maps.

They minimise ‖δ‖₂² + c·f(x + δ) by Adam over w, where x + δ = (tanh w + 1) / 2 keeps an image in its box and f is a
hinge that is flat once the attack succeeds by a margin κ. Here:

* a feature map has no box; what bounds δ is the channel's ball, ‖δ‖ ≤ Δ of PRBI Eq. (1). So δ = Δ tanh w, entry by
  entry for L∞, and of the length for L2: whatever w is, δ lies inside;
* f is minus the objective that all attacks share, PRBI Eq. (2); its `MARGIN` is their κ;
* ‖δ‖₂² is counted as a share of the largest that the ball allows, so that c means the same for every map and budget;
* they search for the smallest c that succeeds. To a set of boxes success is no yes or no, and 15 steps (PRBI Sec. 11.1)
  leave no room: c is fixed, and the iterate of the lowest value is kept, that is, of the most damage for its size.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from agents.attacks.constraint import FeasibleSet
from agents.attacks.pgd import Optimum, better, check_steps
from agents.attacks.targets import Loss
from cp_env.perturbation.ball import MAP


@dataclass(frozen=True)
class CarliniWagner:
    """Adam over w, `steps` times; the iterate of the lowest value is kept. An `Optimizer`.

    Args:
        steps: of Adam.
        step_size: an absolute length in the ball's norm, as for PGD, of a first step: Adam's rate in w follows from it.
        c: weight of the objective; the larger it is, the less the size of the perturbation counts.
    """

    steps: int = 15
    step_size: float = 0.1
    c: float = 1.0

    def __post_init__(self) -> None:
        check_steps(self.steps, self.step_size)
        if not self.c > 0:
            raise ValueError(f"Carlini and Wagner's constant must be positive, got c={self.c}")

    def __call__(self, loss: Loss, start: Float[Tensor, "T m C H W"], feasible: FeasibleSet) -> Optimum:
        """See `Optimizer`; the value of a δ is minus the one that they minimise."""
        start = feasible.project(start)
        if feasible.budget == 0:
            return start, start.new_zeros(len(start))
        inside, outside, size = SPACES[feasible.norm]
        entries = 1 if feasible.norm == "linf" else math.prod(start.shape[-3:])
        radius = torch.as_tensor(feasible.radius, dtype=start.dtype, device=start.device)
        w = outside(start / radius.clamp(min=torch.finfo(start.dtype).tiny)).requires_grad_()
        adam = torch.optim.Adam([w], lr=self.step_size / feasible.budget / math.sqrt(entries))
        best, best_value = start, start.new_full((len(start),), -torch.inf)
        for step in range(self.steps + 1):
            part = feasible.mask(inside(w))  # δ as a part of the largest
            delta = radius * part
            value = self.c * loss(delta) - size(part).sum(1)
            best, best_value = better(best, best_value, delta.detach(), value.detach())
            if step < self.steps:
                (w.grad,) = torch.autograd.grad(-value.sum(), w)
                adam.step()
        return best, best_value


EDGE = 1 - 1e-3
"""The largest part of the ball from which w starts: on its surface w would be infinite."""


def _entrywise(w: Float[Tensor, "*b C H W"]) -> Float[Tensor, "*b C H W"]:
    return w.tanh()


def _radial(w: Float[Tensor, "*b C H W"]) -> Float[Tensor, "*b C H W"]:
    length = (w.square().sum(MAP, keepdim=True) + torch.finfo(w.dtype).tiny).sqrt()
    return w * (length.tanh() / length)


def _entrywise_back(part: Float[Tensor, "*b C H W"]) -> Float[Tensor, "*b C H W"]:
    return part.clamp(-EDGE, EDGE).atanh()


def _radial_back(part: Float[Tensor, "*b C H W"]) -> Float[Tensor, "*b C H W"]:
    length = torch.linalg.vector_norm(part, dim=MAP, keepdim=True).clamp(min=torch.finfo(part.dtype).tiny)
    return part * (length.clamp(max=EDGE).atanh() / length)


def _mean_square(share: Float[Tensor, "*b C H W"]) -> Float[Tensor, "*b"]:
    return share.square().mean(MAP)


def _square(share: Float[Tensor, "*b C H W"]) -> Float[Tensor, "*b"]:
    return share.square().sum(MAP)


Map = Callable[[Tensor], Tensor]

SPACES: dict[str, tuple[Map, Map, Map]] = {
    "linf": (_entrywise, _entrywise_back, _mean_square),
    "l2": (_radial, _radial_back, _square),
}
"""For each norm, δ / Δ as a function of w, its inverse, and ‖δ‖₂² as a share of the largest in the ball."""
