"""Where the perturbations of an attack may lie: a share of the ball, on some cells."""

from __future__ import annotations

from dataclasses import dataclass, replace

from jaxtyping import Bool, Float
from torch import Tensor

from cp_env.perturbation.ball import ascend, make_ball


@dataclass(frozen=True, eq=False)
class FeasibleSet:
    """The feasible δ of T teams of m attackers: in a ball of `share` · Δ, on the `cells` that they may change."""

    norm: str
    budget: float  # Δ
    share: float | Float[Tensor, "T 1 1 1 1"] = 1.0  # of Δ, 0 to 1; one for all teams, or one for each
    cells: Float[Tensor, "T m 1 H W"] | None = None  # 1 or 0; all by default

    def of(self, mine: Bool[Tensor, " T"]) -> FeasibleSet:
        """The feasible set of those teams."""
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
        """The direction of steepest ascent on the cells, of norm `share`: steps shrink with the ball. A new tensor."""
        direction = make_ball(self.norm).steepest(self.mask(gradient))
        return direction * self.share if isinstance(self.share, Tensor) else direction

    def project(self, delta: Float[Tensor, "T m C H W"]) -> Float[Tensor, "T m C H W"]:
        """The nearest feasible point."""
        return make_ball(self.norm).project(self.mask(delta), self.radius)

    def ascend(
        self, delta: Float[Tensor, "T m C H W"], gradient: Float[Tensor, "T m C H W"], length: float
    ) -> Float[Tensor, "T m C H W"]:
        """One step of projected ascent from δ, on the cells; a step is as much shorter as the share is smaller."""
        return ascend(make_ball(self.norm), delta, self.steepest(gradient), length, self.radius)
