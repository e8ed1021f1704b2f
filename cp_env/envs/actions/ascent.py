"""Projected ascent of all attackers' δ on the ego's loss, in place; of faint cells a sign knows nothing."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from cp_env.detector.model.warp import Moves
from cp_env.perturbation.ball import make_ball
from cp_env.perturbation.objective import Loss
from cp_env.perturbation.output import AttackedOutput, LinearOutput

ONE_BY_ONE = ("cpu",)
"""Devices on which δ are changed one at a time, so that each stays in the processor's own cache."""

FAINT = 0.01
"""Cells whose gradient is below this share of the strongest cell's are left alone: a sign knows no magnitude, and
without this a narrow aim would still fill the whole map."""


def climb(
    delta: Float[Tensor, "B k C H W"],
    radius: Float[Tensor, "B k"],
    perceive: AttackedOutput | LinearOutput,
    damage: Loss,
    norm: str,
    steps: int,
) -> None:
    """Move δ, in place, by some steps of projected ascent, each of twice its radius over their number.

    Args:
        delta: in the senders' frames; each in its ball.
        radius: of each δ's ball.
        perceive: the output that δ leads to, one view a world.
        damage: what rises.
        norm: of the balls.
        steps: how many.
    """
    for _ in range(steps):
        if norm == "linf" and isinstance(perceive, LinearOutput) and perceive.moves is not None:
            _climb_fused(delta, radius, perceive, perceive.moves, damage, 2.0 / steps)
        else:
            _climb(delta, radius, perceive, damage, norm, 2.0 / steps)


def _climb(
    delta: Float[Tensor, "B k C H W"],
    radius: Float[Tensor, "B k"],
    perceive: AttackedOutput | LinearOutput,
    damage: Loss,
    norm: str,
    stride: float,
) -> None:
    """One step by the gradient of every δ."""
    ball = make_ball(norm)
    leaf = delta.detach().requires_grad_()  # on the same memory: its graph is gone when δ changes
    with torch.enable_grad():
        (gradient,) = torch.autograd.grad(damage(perceive(leaf)).sum(), leaf)
    gradient = gradient.contiguous()  # it is written to, and could be one number for many
    for part, reach in parts(delta, radius):
        slope, here = gradient[part], delta[part]
        length = (_strong(slope, norm) * reach).mul_(stride)
        here.addcmul_(ball.steepest(slope, out=slope), length)
        ball.project(here, reach, out=here)


def _climb_fused(
    delta: Float[Tensor, "B k C H W"],
    radius: Float[Tensor, "B k"],
    perceive: LinearOutput,
    moves: Moves,
    damage: Loss,
    stride: float,
) -> None:
    """The same by the gradient of the fused maps, of which a δ's own is a share, moved: its signs are found once."""
    leaf = perceive.fused(delta).requires_grad_()
    with torch.enable_grad():
        (gradient,) = torch.autograd.grad(damage(perceive.decode(leaf)).sum(), leaf)
    fused = gradient.flatten(2).unbind()
    places = delta.view(-1, delta.shape[2], math.prod(delta.shape[3:])).unbind()
    reaches, slope, last = radius.flatten().tolist(), torch.empty_like(places[0]), -1
    for b, i, to, of, share in zip(*moves[:5], strict=True):
        if b != last:
            slope.copy_(fused[b])  # a decoder may give its gradient with the channels last
            strongest, last = torch.maximum(slope.amax(0, keepdim=True), slope.amin(0, keepdim=True).neg_()), b
            slope.sign_()
        felt, here, reach = strongest[:, to] * share, places[i][:, of], reaches[i]
        length = (felt > FAINT * felt.amax()).to(slope).mul_(reach).mul_(stride)
        torch.clamp(here.addcmul_(slope[:, to], length), -reach, reach, out=here)


def parts(delta: Float[Tensor, "B k C H W"], *numbers: Float[Tensor, "B k"]) -> Iterator[tuple[Any, ...]]:
    """The places of the δ that are worked on in one go, and their numbers: plain ones of a single δ, or tensors."""
    if delta.device.type in ONE_BY_ONE:
        places = ((world, slice(slot, slot + 1)) for world, slot in np.ndindex(*delta.shape[:2]))
        yield from zip(places, *(one.flatten().tolist() for one in numbers), strict=True)
    else:
        yield slice(None), *(one[..., None, None, None] for one in numbers)


def _strong(gradient: Float[Tensor, "*b C H W"], norm: str) -> Float[Tensor, "..."]:
    """1 in the cells whose gradient is not faint; a direction of the L2 ball keeps its magnitudes: 1 for all."""
    if norm != "linf":
        return gradient.new_ones(gradient.dim() * (1,))
    cells = torch.maximum(gradient.amax(-3, keepdim=True), gradient.amin(-3, keepdim=True).neg_())
    return (cells > FAINT * cells.amax((-2, -1), keepdim=True)).to(gradient)
