"""What liars maximise: our reading of L_det in the paper's attack, max over δ of Σ L_det(d, d'), PRBI Eq. (2).

The paper is silent on L_det and on d'. The attack here is untargeted: d is the decoder's own clean output (a liar knows
no ground truth), and the loss is a sum of three, each measured per vehicle the ego would have seen:

    hide   scores fall on object cells, the cells in which the clean output sees a vehicle;
    spoof  scores rise elsewhere, softly counted once for every block of the size of a car, so that the many easy
           background cells do not win over the few that can become a ghost, and ghosts come out apart from each other;
    drift  boxes move on object cells: L1 of the regression.

Scores enter as logits that stop counting `MARGIN` beyond the middle: what is already hidden or already a ghost takes no
more of the budget (the hinge of Carlini and Wagner).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

if TYPE_CHECKING:
    from cp_env.detector.decoder import Dense

OBJECT_PROBABILITY = 0.2
"""Cells whose clean probability is at least this are object cells, weighted by it."""

MARGIN = 3.0
"""Logit beyond which a hidden object or a ghost is as good as it gets."""

BLOCK = 4
"""Side of a spoofing block in score-map cells; about one car."""

REACH = 2.0
"""Drift of a box component (m, log m or unit vector) beyond which it counts no more: no overlap is left."""

Weight = float | Float[Tensor, "B"]


def adversarial_loss(
    dense: Dense,
    clean: Dense,
    *,
    hide: Weight = 1.0,
    spoof: Weight = 1.0,
    drift: Weight = 1.0,
    where: Float[Tensor, "B h w"] | None = None,
) -> Float[Tensor, "B"]:
    """How far `dense` lies from `clean`, for each view; differentiable in `dense`, constant in `clean`.

    `hide`, `spoof` and `drift` weigh the three parts, one number or one per view. A negative weight reverses a part.
    `where` weighs the cells of the score map, non-negative; by default all count alike.
    """
    probability = clean.logits.detach().sigmoid()
    objects = probability * (probability >= OBJECT_PROBABILITY)
    count = objects.sum((-2, -1)).clamp(min=1.0)
    weights = objects if where is None else objects * where
    hidden = (weights * _hidden(dense.logits)).sum((-2, -1)) / count
    drifted = (weights * _drifted(dense.boxes, clean.boxes.detach())).sum((-2, -1)) / count
    ghosts = _ghosts(dense.logits, _background(objects), where) / count
    return hide * hidden + spoof * ghosts + drift * drifted


def _hidden(logits: Float[Tensor, "B h w"]) -> Float[Tensor, "B h w"]:
    """Error of calling each cell a background cell, in nats, up to the margin."""
    return functional.softplus(-logits.clamp(min=-MARGIN))


def _drifted(boxes: Float[Tensor, "B P h w"], clean: Float[Tensor, "B P h w"]) -> Float[Tensor, "B h w"]:
    """L1 distance of the box regressions, mean over their components, each up to `REACH`."""
    return (boxes - clean).abs().clamp(max=REACH).mean(1)


def _background(objects: Float[Tensor, "B h w"]) -> Float[Tensor, "B h w"]:
    """1 on cells that neither are object cells nor touch one."""
    near = functional.max_pool2d(objects.unsqueeze(1), kernel_size=3, stride=1, padding=1).squeeze(1)
    return (near == 0).to(objects.dtype)


def _ghosts(
    logits: Float[Tensor, "B h w"], background: Float[Tensor, "B h w"], where: Float[Tensor, "B h w"] | None
) -> Float[Tensor, "B"]:
    """Expected ghosts, in nats: each block counts as its most promising background cells do (log-sum-exp)."""
    floor = torch.finfo(logits.dtype).min / 2
    masked = torch.where(background > 0, logits, torch.full_like(logits, floor))
    tiles = functional.unfold(masked.unsqueeze(1), kernel_size=BLOCK, stride=BLOCK)
    block = torch.logsumexp(tiles, 1)
    error = functional.softplus(block.clamp(max=MARGIN))
    if where is not None:
        error = error * functional.avg_pool2d(where.unsqueeze(1), BLOCK).flatten(1)
    return error.sum(1)
