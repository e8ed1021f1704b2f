"""The ego's output as a function of the attackers' δ, PRBI Eq. (1): what gradient attacks differentiate."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from cp_env.detector.model.base import moves_as_ours
from cp_env.detector.model.decoder import Dense
from cp_env.detector.model.warp import Moves, add_weighted, weighted_moves
from cp_env.detector.protocol import DetectorLike, LinearFusion, dtype_of
from cp_env.perturbation.channel import inject


def attacked_output(
    detector: DetectorLike,
    received: Float[Tensor, "E N C H W"],
    coverage: Float[Tensor, "E N H W"],
    attackers: Int[Tensor, "T k"],
    ego_T_attacker: Float[Tensor, "T k 3"],
    world: Int[Tensor, " B"],
    groups: Bool[Tensor, "B N"],
    *,
    worlds: Int[Tensor, " T"] | None = None,
    sending: Bool[Tensor, "T k"] | None = None,
) -> AttackedOutput | LinearOutput:
    """The ego's output as a function of the attackers' δ, Eq. (1): of group `groups[b]` in world `world[b]`.

    Where the fusion is linear in the maps, the unperturbed ones are fused once and not at every call.

    Args:
        detector: the victim, or a copy of it in another precision.
        received: all maps in the ego's frame, unperturbed. A linear fusion fuses them in their own precision.
        coverage: the cells that each map covers.
        attackers: numbers of the malicious vehicles of each world.
        ego_T_attacker: their poses in the ego's frame; m, m, rad.
        world: the world of each view.
        groups: the vehicles fused in each view.
        worlds: which of E worlds the T are that δ is given for; all of them by default. `detector` is bound to these
            alone.
        sending: whose δ may differ from zero; everyone's by default. No other's need be looked at.

    Returns:
        A function from δ, in the attackers' own frames, to the decoder's output; differentiable.
    """
    row = world if worlds is None else worlds[world]
    weights = detector.linear_weights(coverage, row, groups) if isinstance(detector, LinearFusion) else None
    if weights is None or not isinstance(detector, LinearFusion):
        if worlds is not None:
            received, coverage = received[worlds], coverage[worlds]
        received = received.to(dtype_of(detector))
        return AttackedOutput(detector, received, coverage, attackers, ego_T_attacker, world, groups)
    share = torch.take_along_dim(weights, attackers[world][..., None, None], 1)[:, :, None]
    moves = weighted_moves(share, world, ego_T_attacker, detector.extent, sending) if moves_as_ours(detector) else None
    benign = detector.fuse(received, coverage, row, groups)
    return LinearOutput(detector, detector.decode, benign, share, ego_T_attacker, world, moves)


@dataclass(frozen=True, eq=False)
class AttackedOutput:
    """By the victim's own warp and fusion, whatever they are."""

    detector: DetectorLike
    received: Float[Tensor, "T N C H W"]
    coverage: Float[Tensor, "T N H W"]
    attackers: Int[Tensor, "T k"]
    ego_T_attacker: Float[Tensor, "T k 3"]
    world: Int[Tensor, " B"]
    groups: Bool[Tensor, "B N"]

    def __call__(self, delta: Float[Tensor, "T k C H W"]) -> Dense:
        """The decoder's output under δ; differentiable."""
        attacked = inject(self.received, self.detector.warp(delta, self.ego_T_attacker), self.attackers)
        return self.detector.perceive(attacked, self.coverage, self.world, self.groups)


@dataclass(frozen=True, eq=False)
class LinearOutput:
    """For a fusion that is linear in the maps: the shares of δ are added to what it makes of unperturbed ones."""

    detector: DetectorLike  # whose warp moves δ that move otherwise
    decode: Callable[[Float[Tensor, "B C H W"]], Dense]
    benign: Float[Tensor, "B C H W"]  # fused without δ
    share: Float[Tensor, "B k 1 H W"]  # weight of each δ in each cell of a fused map
    ego_T_attacker: Float[Tensor, "T k 3"]
    world: Int[Tensor, " B"]
    moves: Moves | None  # where δ move by whole cells on the CPU

    def __call__(self, delta: Float[Tensor, "T k C H W"]) -> Dense:
        """The decoder's output under δ; differentiable."""
        return self.decode(self.fused(delta))

    def fused(self, delta: Float[Tensor, "T k C H W"]) -> Float[Tensor, "B C H W"]:
        """The fused maps under δ; differentiable."""
        if self.moves is not None:
            return add_weighted(self.benign, delta, self.moves)
        warped = self.detector.warp(delta, self.ego_T_attacker)
        one_each = torch.equal(self.world, torch.arange(len(delta), device=self.world.device))
        return self.benign + ((warped if one_each else warped[self.world]) * self.share).sum(1)
