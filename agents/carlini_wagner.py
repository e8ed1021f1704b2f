"""The attack of Carlini and Wagner ("Towards Evaluating the Robustness of Neural Networks", 2017, Secs. V, VI) on maps.

They minimise ‖δ‖₂² + c·f(x + δ) by Adam over w, where x + δ = (tanh w + 1) / 2 keeps an image in its box and f is a
hinge that is flat once the attack succeeds by a margin κ. Here:

* a feature map has no box; what bounds δ is the channel's ball, ‖δ‖ ≤ Δ of PRBI Eq. (1). So δ = Δ tanh w, entry by
  entry for L∞, and of the length for L2: whatever w is, δ lies inside;
* f is minus the objective that all attackers share, PRBI Eq. (2); its `MARGIN` is their κ;
* ‖δ‖₂² is counted as a share of the largest that the ball allows, so that c means the same for every map and budget;
* they search for the smallest c that succeeds. To a set of boxes success is no yes or no, and 15 steps (PRBI Sec. 11.1)
  leave no room: c is fixed, and the iterate of the lowest value is kept, that is, of the most damage for its size.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import torch
from jaxtyping import Float
from torch import Tensor

from agents.ascent import Ascent, Loss

_MAP = (-3, -2, -1)


@dataclass
class CarliniWagner(Ascent):
    """Carlini and Wagner's attack, joint over a world's liars, from w = 0.

    `step_size` is an absolute length in the ball's norm, as for PGD, of a first step: Adam's rate in w follows from it.
    The larger `c`, the less the size of the perturbation counts.
    """

    random_start: bool = field(default=False, init=False)
    c: float = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.c > 0:
            raise ValueError(f"Carlini and Wagner's constant must be positive, got c={self.c}")

    def _search(
        self, loss: Loss, start: Float[Tensor, "B k C H W"], norm: str, budget: float
    ) -> Float[Tensor, "B k C H W"]:
        if budget == 0:
            return start
        inside, size = SPACES[norm]
        entries = 1 if norm == "linf" else math.prod(start.shape[-3:])
        w = start.detach().clone().requires_grad_()
        adam = torch.optim.Adam([w], lr=self.step_size / budget / math.sqrt(entries))
        best, lowest = start, start.new_full((len(start),), torch.inf)
        for step in range(self.steps + 1):
            share = inside(w)  # δ / Δ
            value = size(share).sum(1) - self.c * loss(budget * share)
            better = value.detach() < lowest
            best = torch.where(better[:, None, None, None, None], budget * share.detach(), best)
            lowest = torch.where(better, value.detach(), lowest)
            if step < self.steps:
                (w.grad,) = torch.autograd.grad(value.sum(), w)
                adam.step()
        return best


def _entrywise(w: Float[Tensor, "*b C H W"]) -> Float[Tensor, "*b C H W"]:
    return w.tanh()


def _radial(w: Float[Tensor, "*b C H W"]) -> Float[Tensor, "*b C H W"]:
    length = (w.square().sum(_MAP, keepdim=True) + torch.finfo(w.dtype).tiny).sqrt()
    return w * (length.tanh() / length)


def _mean_square(share: Float[Tensor, "*b C H W"]) -> Float[Tensor, "*b"]:
    return share.square().mean(_MAP)


def _square(share: Float[Tensor, "*b C H W"]) -> Float[Tensor, "*b"]:
    return share.square().sum(_MAP)


Space = tuple[Callable[[Tensor], Tensor], Callable[[Tensor], Tensor]]

SPACES: dict[str, Space] = {"linf": (_entrywise, _mean_square), "l2": (_radial, _square)}
"""For each norm, δ / Δ as a function of w, and ‖δ‖₂² as a share of the largest in the ball."""
