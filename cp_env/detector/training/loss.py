"""L_det: how far the decoder's output lies from the truth, as penalty-reduced focal loss and L1 of the boxes.

This is the detection loss that trains f_E and f_D, the L_det of PRBI Eq. (2), built as in Zhou et al., "Objects as
Points", Eqs. (1) and (2). What attackers maximise is `adversarial.adversarial_loss`.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional

from cp_env.detector.model.decoder import Dense, cell_centres

SIGMA = 1.0  # m; spread of the target around a centre
HIDDEN_RADIUS = 2.0  # m; no loss this close to the centre of a vehicle that nobody in the group saw
BOX_WEIGHT = 2.0
CHANNEL_WEIGHTS = (1.0, 1.0, 2.0, 2.0, 1.0, 1.0)  # dx, dy, log length, log width, sin 2yaw, cos 2yaw


@dataclass(frozen=True, eq=False)
class Targets:
    """What `Dense` should have been.

    heat: 1 in the cell of a visible vehicle's centre, falling off around it.
    weight: 0 in cells that are not judged, 1 elsewhere.
    boxes: as in `Dense`, of the nearest visible vehicle.
    box_weight: `heat` where the centre is less than 1.5 cells away in x and in y, 0 elsewhere.
    """

    heat: Float[Tensor, "B h w"]
    weight: Float[Tensor, "B h w"]
    boxes: Float[Tensor, "B 6 h w"]
    box_weight: Float[Tensor, "B h w"]

    def to(self, device: str | torch.device) -> Targets:
        """The same on `device`."""
        return Targets(*(part.to(device) for part in (self.heat, self.weight, self.boxes, self.box_weight)))


def box_code(boxes: Float[Tensor, "*n 5"]) -> Float[Tensor, "*n 4"]:
    """log length, log width, sin 2yaw, cos 2yaw of boxes (x, y, length, width, yaw)."""
    double = 2 * boxes[..., 4]
    return torch.stack([boxes[..., 2].log(), boxes[..., 3].log(), double.sin(), double.cos()], dim=-1)


def targets(boxes: Float[Tensor, "L 5"], visible: Bool[Tensor, "B L"], size: int, extent: float) -> Targets:
    """One scene's boxes (ego's grid frame) as targets for B groups, each of which sees only some of them.

    `size` is that of the score map; vehicles outside ±extent may be among the boxes and leave no centre.
    """
    centre = cell_centres(size, extent, boxes)
    dx = boxes[:, 0, None, None] - centre[None, None, :]  # [L, 1, w]
    dy = boxes[:, 1, None, None] - centre[None, :, None]  # [L, h, 1]
    half = extent / size
    distance = (dx**2 + dy**2) + torch.zeros(len(boxes), size, size)
    own_cell = (dx >= -half) & (dx < half) & (dy >= -half) & (dy < half)
    near = (dx.abs() < 3 * half) & (dy.abs() < 3 * half)
    bump = torch.where(own_cell, 1.0, torch.exp(-distance / (2 * SIGMA**2)))
    seen = visible[:, :, None, None]
    if len(boxes) == 0:
        nothing = boxes.new_zeros(len(visible), size, size)
        return Targets(nothing, torch.ones_like(nothing), boxes.new_zeros(len(visible), 6, size, size), nothing)
    heat = torch.where(seen, bump, 0.0).amax(dim=1)
    hidden = (~seen & (distance < HIDDEN_RADIUS**2)).any(dim=1)
    weight = torch.where(hidden & (heat < 1), 0.0, 1.0)
    nearest = torch.where(seen, distance, torch.inf).argmin(dim=1)  # [B, h, w]
    code = box_code(boxes)[nearest].movedim(-1, 1)
    offset = torch.stack([boxes[:, 0][nearest] - centre, boxes[:, 1][nearest] - centre[:, None]], dim=1)
    box_weight = torch.where((seen & near).any(dim=1), heat, 0.0)
    return Targets(heat, weight, torch.cat([offset, code], dim=1), box_weight)


def detection_loss(dense: Dense, wanted: Targets) -> Float[Tensor, ""]:
    """L_det, averaged over the visible vehicles of the whole batch."""
    score = functional.logsigmoid(dense.logits), functional.logsigmoid(-dense.logits)  # log p, log(1 - p)
    probability = dense.logits.sigmoid()
    is_centre = (wanted.heat == 1).to(dense.logits)
    count = is_centre.sum().clamp(min=1)
    object_loss = is_centre * (1 - probability) ** 2 * score[0]
    background = (1 - is_centre) * wanted.weight * (1 - wanted.heat) ** 4 * probability**2 * score[1]
    channel = dense.boxes.new_tensor(CHANNEL_WEIGHTS)[:, None, None]
    error = functional.smooth_l1_loss(dense.boxes, wanted.boxes, reduction="none", beta=0.05) * channel
    box_loss = (error * wanted.box_weight[:, None]).sum() / wanted.box_weight.sum().clamp(min=1)
    return -(object_loss + background).sum() / count + BOX_WEIGHT * box_loss


def stack(parts: list[Targets]) -> Targets:
    """Targets of several scenes, one after the other."""
    return Targets(
        torch.cat([part.heat for part in parts]),
        torch.cat([part.weight for part in parts]),
        torch.cat([part.boxes for part in parts]),
        torch.cat([part.box_weight for part in parts]),
    )
