"""The balls a perturbation lives in, ‖δ‖ ≤ Δ of PRBI Eq. (1): the norm decides three tiny methods and nothing else.

One δ is one liar's feature map (C, H, W); leading axes are independent balls.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from cp_env.perturbation import channel

MAP = (-3, -2, -1)


@runtime_checkable
class Ball(Protocol):
    def random(self, shape: tuple[int, int, int, int], budget: float, rng: np.random.Generator) -> Tensor:
        """A random δ (k, C, H, W) in the ball, on the CPU."""
        ...

    def steepest(self, gradient: Float[Tensor, "*b C H W"]) -> Float[Tensor, "*b C H W"]:
        """The direction of unit norm that climbs fastest, a new tensor; zero where the gradient is."""
        ...

    def project(self, delta: Float[Tensor, "*b C H W"], budget: float | Tensor) -> Float[Tensor, "*b C H W"]:
        """The nearest point of the ball; of balls of their own sizes, if `budget` is a tensor that broadcasts."""
        ...


class Linf:
    """Every number at most Δ in size."""

    def random(self, shape: tuple[int, int, int, int], budget: float, rng: np.random.Generator) -> Tensor:
        return torch.from_numpy(rng.random(shape, dtype=np.float32)).mul_(2 * budget).sub_(budget)

    def steepest(self, gradient: Float[Tensor, "*b C H W"]) -> Float[Tensor, "*b C H W"]:
        return gradient.sign()

    def project(self, delta: Float[Tensor, "*b C H W"], budget: float | Tensor) -> Float[Tensor, "*b C H W"]:
        return channel.project(delta, budget, "linf")


class L2:
    """The whole map at most Δ long."""

    def random(self, shape: tuple[int, int, int, int], budget: float, rng: np.random.Generator) -> Tensor:
        """Uniform in direction and in length: uniform in volume would put every start on the surface."""
        direction = torch.from_numpy(rng.standard_normal(shape, dtype=np.float32))
        length = torch.from_numpy(rng.random((shape[0], 1, 1, 1), dtype=np.float32))
        return self.project(self.steepest(direction) * length * budget, budget)

    def steepest(self, gradient: Float[Tensor, "*b C H W"]) -> Float[Tensor, "*b C H W"]:
        norm = torch.linalg.vector_norm(gradient, dim=MAP, keepdim=True)
        return gradient / norm.clamp(min=torch.finfo(gradient.dtype).tiny)

    def project(self, delta: Float[Tensor, "*b C H W"], budget: float | Tensor) -> Float[Tensor, "*b C H W"]:
        return channel.project(delta, budget, "l2")


BALLS: dict[str, Ball] = {"linf": Linf(), "l2": L2()}


def make_ball(norm: str) -> Ball:
    """The ball of a norm's name."""
    if norm not in BALLS:
        raise ValueError(f"norm must be one of {sorted(BALLS)}, got {norm!r}")
    return BALLS[norm]


@dataclass(frozen=True, eq=False)
class Domain:
    """Where the δ of T teams of m liars may lie: in a ball of `share` · Δ, on the `cells` that they may touch."""

    norm: str
    budget: float  # Δ
    share: float | Float[Tensor, "T 1 1 1 1"] = 1.0  # of Δ, 0 to 1; one for all teams, or one for each
    cells: Float[Tensor, "T m 1 H W"] | None = None  # 1 or 0; all by default

    def of(self, mine: Bool[Tensor, " T"]) -> Domain:
        """That of those teams."""
        share = self.share[mine] if isinstance(self.share, Tensor) else self.share
        return replace(self, share=share, cells=None if self.cells is None else self.cells[mine])

    @property
    def radius(self) -> float | Float[Tensor, "T 1 1 1 1"]:
        """The largest ‖δ‖."""
        return self.budget * self.share

    def mask(self, delta: Float[Tensor, "T m C H W"]) -> Float[Tensor, "T m C H W"]:
        """Zero outside the cells."""
        return delta if self.cells is None else delta * self.cells

    def steepest(self, gradient: Float[Tensor, "T m C H W"]) -> Float[Tensor, "T m C H W"]:
        """The direction that climbs fastest on the cells, of norm `share`: steps shrink with the ball. A new tensor."""
        direction = make_ball(self.norm).steepest(self.mask(gradient))
        return direction * self.share if isinstance(self.share, Tensor) else direction

    def project(self, delta: Float[Tensor, "T m C H W"]) -> Float[Tensor, "T m C H W"]:
        """The nearest point of the domain."""
        return make_ball(self.norm).project(self.mask(delta), self.radius)
