"""The balls a perturbation lies in, ‖δ‖ ≤ Δ of PRBI Eq. (1), and the ascent step that stays inside.

The norm decides three small methods and nothing else. One δ is one attacker's feature map (C, H, W); leading axes are
independent balls.
"""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from cp_env.perturbation import channel

MAP = (-3, -2, -1)


@runtime_checkable
class Ball(Protocol):
    """What a norm decides: a random point, a direction, the nearest point."""

    def random(self, shape: tuple[int, int, int, int], budget: float, rng: np.random.Generator) -> Tensor:
        """A random δ (k, C, H, W) in the ball, on the CPU."""
        ...

    def steepest(self, gradient: Float[Tensor, "*b C H W"], out: Tensor | None = None) -> Float[Tensor, "*b C H W"]:
        """The direction of unit norm in which the loss rises fastest, zero where the gradient is: new, or `out`."""
        ...

    def project(
        self, delta: Float[Tensor, "*b C H W"], budget: float | Tensor, out: Tensor | None = None
    ) -> Float[Tensor, "*b C H W"]:
        """The nearest point of the ball; of balls of their own sizes, if `budget` is a tensor that broadcasts.

        It is written to `out`, which may be δ itself, or to a new tensor.
        """
        ...


class Linf:
    """Every number at most Δ in size."""

    def random(self, shape: tuple[int, int, int, int], budget: float, rng: np.random.Generator) -> Tensor:
        return torch.from_numpy(rng.random(shape, dtype=np.float32)).mul_(2 * budget).sub_(budget)

    def steepest(self, gradient: Float[Tensor, "*b C H W"], out: Tensor | None = None) -> Float[Tensor, "*b C H W"]:
        return torch.sign(gradient, out=out)

    def project(
        self, delta: Float[Tensor, "*b C H W"], budget: float | Tensor, out: Tensor | None = None
    ) -> Float[Tensor, "*b C H W"]:
        return channel.project(delta, budget, "linf", out)


class L2:
    """The whole map at most Δ long."""

    def random(self, shape: tuple[int, int, int, int], budget: float, rng: np.random.Generator) -> Tensor:
        """Uniform in direction and in length: uniform in volume would put every start on the surface."""
        direction = torch.from_numpy(rng.standard_normal(shape, dtype=np.float32))
        length = torch.from_numpy(rng.random((shape[0], 1, 1, 1), dtype=np.float32))
        return self.project(self.steepest(direction) * length * budget, budget)

    def steepest(self, gradient: Float[Tensor, "*b C H W"], out: Tensor | None = None) -> Float[Tensor, "*b C H W"]:
        norm = torch.linalg.vector_norm(gradient, dim=MAP, keepdim=True)
        return torch.div(gradient, norm.clamp(min=torch.finfo(gradient.dtype).tiny), out=out)

    def project(
        self, delta: Float[Tensor, "*b C H W"], budget: float | Tensor, out: Tensor | None = None
    ) -> Float[Tensor, "*b C H W"]:
        return channel.project(delta, budget, "l2", out)


BALLS: dict[str, Ball] = {"linf": Linf(), "l2": L2()}


def make_ball(norm: str) -> Ball:
    """The ball of a norm's name."""
    if norm not in BALLS:
        raise ValueError(f"norm must be one of {sorted(BALLS)}, got {norm!r}")
    return BALLS[norm]


def ascend(
    ball: Ball,
    delta: Float[Tensor, "*b C H W"],
    direction: Float[Tensor, "*b C H W"],
    length: float | Tensor,
    radius: float | Tensor,
) -> Float[Tensor, "*b C H W"]:
    """One step of projected ascent: from δ along `direction`, a fresh tensor that becomes the result, into the ball."""
    return ball.project(direction.mul_(length).add_(delta), radius, out=direction)
