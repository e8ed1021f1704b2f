"""The adversarial objective: our reading of L_det in the paper's attack, max over δ of Σ L_det(d, d'), PRBI Eq. (2).

The paper is silent on L_det and on d'. The attack here is untargeted: d is the decoder's own clean output (an attacker
knows no ground truth). The loss is a sum of three parts. Each is divided by the number of vehicles the ego would have
seen, and is zero when nothing changed:

    hide   logits fall on object cells, the cells in which the clean output sees a vehicle;
    spoof  logits rise elsewhere, softly counted once for every block of the size of a car, so that the many easy
           background cells do not win over the few that can become a ghost, and ghosts come out apart from each other;
    drift  boxes move on object cells: L1 of the regression.

Logits stop counting `MARGIN` beyond the middle: what is already hidden or already a ghost takes no more of the budget
(the hinge of Carlini and Wagner). Up to there a hidden object counts in logits, not in nats, whose gradient would
vanish on the objects that the detector is surest of.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional

from cp_env.detector.model.decoder import Dense, highest_neighbour

OBJECT_PROBABILITY = 0.2
"""Cells whose clean probability is at least this are object cells, weighted by it."""

MARGIN = 3.0
"""Logit beyond which a hidden object or a ghost is as good as it gets."""

BLOCK = 4
"""Side of a spoofing block in score-map cells; about one car."""

REACH = 2.0
"""Drift of a box component (m, log m or unit vector) beyond which it counts no more: no overlap is left."""

STILL = 1e-4
"""Drift of a box component below which it has not moved. An unperturbed view differs from the clean one by rounding
only, and a perturbation that starts there would be pulled wherever the rounding points, which depends on the batch."""

Weight = float | Float[Tensor, " B"]


Loss = Callable[[Dense], Float[Tensor, " B"]]


def adversarial_loss(
    dense: Dense,
    clean: Dense,
    *,
    hide: Weight = 1.0,
    spoof: Weight = 1.0,
    drift: Weight = 1.0,
    where: Float[Tensor, "B h w"] | None = None,
) -> Float[Tensor, " B"]:
    """How far `dense` lies from `clean`, for each view; differentiable in `dense`, constant in `clean`.

    Args:
        dense: the attacked output.
        clean: the output it is compared with.
        hide: weight of hidden objects, one number or one per view; a negative one reverses the part.
        spoof: weight of ghosts, likewise.
        drift: weight of moved boxes, likewise.
        where: weights of the score map's cells, non-negative; equal by default.

    Returns:
        The loss of each view.
    """
    return distance_from(clean, hide=hide, spoof=spoof, drift=drift, where=where)(dense)


def distance_from(
    clean: Dense, *, hide: Weight, spoof: Weight, drift: Weight, where: Float[Tensor, "B h w"] | None = None
) -> Loss:
    """`adversarial_loss` as a function of `dense`, for a `clean` that stays: what depends on it alone is done once."""
    objects = object_cells(clean)
    count = objects.sum((-2, -1)).clamp(min=1.0)
    taken = _near(objects)
    weights = objects if where is None else objects * where
    view, row, column = weights.nonzero(as_tuple=True)  # few: the boxes of all other cells are not needed
    conceal, displace = (weights[view, row, column] * _of_each(w, count)[view] for w in (hide, drift))
    shown, box = _capped(-clean.logits.detach()[view, row, column]), clean.boxes.detach()[view, :, row, column]
    ghosts = _ghosts(clean.logits.detach(), taken, where)

    def loss(dense: Dense) -> Float[Tensor, " B"]:
        hidden = _capped(-dense.logits[view, row, column]) - shown
        moved = (dense.boxes[view, :, row, column] - box).abs()
        drifted = functional.threshold(moved, STILL, 0.0).clamp(max=REACH).mean(1)
        invented = spoof * (_ghosts(dense.logits, taken, where) - ghosts)
        return invented.index_add(0, view, conceal * hidden + displace * drifted) / count

    return loss


def object_cells(clean: Dense) -> Float[Tensor, "B h w"]:
    """The probability of the cells in which a view sees a vehicle, 0 elsewhere."""
    probability = clean.logits.detach().sigmoid()
    return probability * (probability >= OBJECT_PROBABILITY)


def _of_each(weight: Weight, like: Float[Tensor, " B"]) -> Float[Tensor, " B"]:
    """The weight of each view."""
    return torch.as_tensor(weight, dtype=like.dtype, device=like.device).expand(len(like))


def _capped(logits: Float[Tensor, "..."]) -> Float[Tensor, "..."]:
    """Logits in the attacker's favour, up to the margin."""
    return logits.clamp(max=MARGIN)


def _near(objects: Float[Tensor, "B h w"]) -> Bool[Tensor, "B h w"]:
    """The cells that are object cells or touch one: no place for a ghost."""
    return highest_neighbour(objects) > 0


def _ghosts(
    logits: Float[Tensor, "B h w"], taken: Bool[Tensor, "B h w"], where: Float[Tensor, "B h w"] | None
) -> Float[Tensor, " B"]:
    """Expected ghosts, in nats: each block counts as its most promising free cells do (log-sum-exp)."""
    masked = logits.masked_fill(taken, torch.finfo(logits.dtype).min / 2)
    tiles = functional.unfold(masked.unsqueeze(1), kernel_size=BLOCK, stride=BLOCK)
    block = torch.logsumexp(tiles, 1)
    error = functional.softplus(_capped(block))
    if where is not None:
        error = error * functional.avg_pool2d(where.unsqueeze(1), BLOCK).flatten(1)
    return error.sum(1)
