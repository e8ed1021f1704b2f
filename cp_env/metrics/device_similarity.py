"""Similarities of many pairs of views on a device: one transfer there, one back, and no loop over pairs between them.

The values are those of `metrics.similarity`, which is faster on a CPU. Views whose boxes have several candidates, which
suppression makes rare, are matched by the Hungarian method on the CPU.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from cp_env.geometry.device_boxes import overlaps
from cp_env.metrics import similarity
from cp_env.types import View

Compare = Callable[[Sequence[tuple[View, View]]], Float[np.ndarray, " V"]]
Jaccard = Callable[[Sequence[np.ndarray], Sequence[np.ndarray]], Float[np.ndarray, " V"]]


def matching_on(device: torch.device) -> tuple[Compare, Jaccard]:
    """The similarities of many pairs of views, and of many pairs of sets of boxes, as that kind of device wants it."""
    if device.type == "cpu":
        return similarity.view_similarity_many, similarity.jaccard_many
    return partial(view_similarity_many, device=device), partial(jaccard_many, device=device)


def jaccard_many(
    a: Sequence[Float[np.ndarray, "_ 5"]],
    b: Sequence[Float[np.ndarray, "_ 5"]],
    device: torch.device,
    iou: float = 0.5,
) -> Float[np.ndarray, " V"]:
    """`similarity.jaccard_many` on a device."""
    (boxes_a, in_a), (boxes_b, in_b) = padded(a, device), padded(b, device)
    return _jaccard(boxes_a, boxes_b, in_a, in_b, iou)


def view_similarity_many(
    pairs: Sequence[tuple[View, View]], device: torch.device, iou: float = 0.5, *, extent: float = 32.0
) -> Float[np.ndarray, " V"]:
    """`similarity.view_similarity_many` on a device."""
    if not pairs:
        return np.zeros(0)
    a, b = ([view.seen.boxes for view in side] for side in zip(*pairs, strict=True))
    motion = np.stack([np.asarray(one.origin, dtype=np.float64) - other.origin for one, other in pairs])
    (boxes_a, in_a), (boxes_b, in_b) = padded(a, device), padded(b, device)
    shift = torch.from_numpy(motion).to(device)[:, None]
    moves = (shift != 0).any(-1)
    boxes_a = torch.cat([boxes_a[..., :2] + shift, boxes_a[..., 2:]], -1)
    in_a = in_a & (~moves | (boxes_a[..., :2].abs() <= extent).all(-1))
    in_b = in_b & (~moves | ((boxes_b[..., :2] - shift).abs() <= extent).all(-1))
    values = _jaccard(boxes_a, boxes_b, in_a, in_b, iou)
    return np.where((np.abs(motion) >= 2 * extent).any(axis=1), 0.0, values)


def padded(
    sets: Sequence[Float[np.ndarray, "_ 5"]], device: torch.device
) -> tuple[Float[Tensor, "V K 5"], Bool[Tensor, "V K"]]:
    """Sets of boxes as one tensor of double precision, and which rows of it are boxes."""
    count = np.array([len(boxes) for boxes in sets], dtype=np.intp)
    there = np.arange(count.max(initial=0)) < count[:, None]
    rows = np.zeros((*there.shape, 5))
    if count.any():
        rows[there] = np.concatenate(list(sets))
    return torch.from_numpy(rows).to(device), torch.from_numpy(there).to(device)


def _jaccard(
    boxes_a: Float[Tensor, "V A 5"],
    boxes_b: Float[Tensor, "V B 5"],
    in_a: Bool[Tensor, "V A"],
    in_b: Bool[Tensor, "V B"],
    iou: float,
) -> Float[np.ndarray, " V"]:
    """Pairs over the union, for all views at once but those with contested boxes."""
    view, i, j, _ = overlaps(boxes_a, boxes_b, in_a, in_b, iou)
    taken_a, taken_b = _count(in_a, view, i), _count(in_b, view, j)
    pairs, union = taken_a.sum(1), in_a.sum(1) + in_b.sum(1)
    contested = ((taken_a > 1).any(1) | (taken_b > 1).any(1)).cpu().numpy()
    found, whole = pairs.cpu().numpy(), union.cpu().numpy()
    for v in np.flatnonzero(contested).tolist():
        one, other = (rows[v][there[v]].cpu().numpy() for rows, there in ((boxes_a, in_a), (boxes_b, in_b)))
        found[v] = len(similarity.match(one, other, iou))
    return np.where(whole > found, found / np.maximum(whole - found, 1), 1.0)


def _count(there: Bool[Tensor, "V K"], view: Tensor, row: Tensor) -> Tensor:
    """How many pairs each box is in."""
    count = torch.zeros(there.shape, dtype=torch.long, device=there.device)
    return count.index_put_((view, row), torch.ones_like(view), accumulate=True)
