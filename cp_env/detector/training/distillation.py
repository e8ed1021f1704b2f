"""A teacher that fuses points, and what a student learns of it: DiscoNet's training (Li et al., NeurIPS 2021).

The teacher sees what early fusion would show: the returns of all members of a group in one grid of the ego's, encoded
and decoded as a single vehicle's would be. The student fuses maps. Its loss is the detection loss
and the distance to the teacher's features: in every cell the Kullback-Leibler divergence of the softmax over channels,
of the fused map and of the decoder's features. The teacher is needed for training alone and does not ship.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from cp_env.detector.model.decoder import Dense
from cp_env.detector.model.detector import Detector
from cp_env.detector.model.warp import warp
from cp_env.detector.training.data import Batch


def early_fusion(batch: Batch, extent: float) -> Float[Tensor, "B Z R R"]:
    """One grid a view: a cell of the ego's grid is taken if any member of the group has a return there."""
    sent = warp(batch.occupancy[batch.agent].float(), batch.ego_T_sender, extent)  # [E, N, Z, R, R]
    rows = zip(batch.world.tolist(), batch.groups, strict=True)
    return torch.stack([sent[e, group].amax(dim=0) for e, group in rows])


def features(detector: Detector, fused: Float[Tensor, "B C H W"]) -> tuple[Dense, list[Tensor]]:
    """The decoder's output, and the features it came by: the fused map, and those of its lower and its upper level."""
    seen: list[Tensor] = [fused]

    def keep(layer: nn.Module, given: tuple[Tensor, ...], made: Tensor) -> None:
        seen.append(made)

    hooks = [layer.register_forward_hook(keep) for layer in (detector.decoder.down, detector.decoder.top)]
    try:
        return detector.decode(fused), seen
    finally:
        for hook in hooks:
            hook.remove()


def teach(teacher: Detector, batch: Batch) -> list[Tensor]:
    """The teacher's features of every view of a batch."""
    with torch.no_grad():
        return features(teacher, teacher.encode_grids(early_fusion(batch, teacher.extent)))[1]


def divergence(student: list[Tensor], teacher: list[Tensor]) -> Float[Tensor, ""]:
    """L_KD: KL(teacher || student) of the channels of a cell, its mean over cells and views, summed over features."""
    pairs = zip(student, teacher, strict=True)
    return torch.stack([_divergence(ours, theirs) for ours, theirs in pairs]).sum()


def _divergence(student: Float[Tensor, "B C H W"], teacher: Float[Tensor, "B C H W"]) -> Float[Tensor, ""]:
    cells = functional.kl_div(
        student.log_softmax(dim=1), teacher.log_softmax(dim=1), log_target=True, reduction="none"
    ).sum(dim=1)
    return cells.mean()
