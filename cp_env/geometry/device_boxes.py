"""Overlap of oriented boxes and non-maximum suppression in torch, all views in one go, for devices other than the CPU.

The same formula as in `geometry.boxes`, in double precision. There is no loop over views, rows or pairs, so that a GPU
has few and large pieces of work. On a CPU `geometry.boxes` is faster.

Convention: sets of boxes are padded, [V, K, 5], with a mask [V, K] of the rows that count.
"""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

_FORE, _SIDE = (1.0, -1.0, -1.0, 1.0), (1.0, 1.0, -1.0, -1.0)  # as in `geometry.boxes`
_ALONG, _ACROSS = (-2.0, 0.0, 2.0, 0.0), (0.0, -2.0, 0.0, 2.0)
_TINY = 1e-150
_ROUNDING = 1e-14
_SMALLEST = float(torch.finfo(torch.float64).tiny)

Pairs = tuple[Int[Tensor, " P"], Int[Tensor, " P"], Int[Tensor, " P"], Float[Tensor, " P"]]


def overlaps(
    a: Float[Tensor, "V A 5"],
    b: Float[Tensor, "V B 5"],
    in_a: Bool[Tensor, "V A"],
    in_b: Bool[Tensor, "V B"],
    above: float = 0.0,
) -> Pairs:
    """The pairs of a view's boxes whose IoU exceeds `above`: view, row of a, row of b and IoU, in this order."""
    view, i, j = (_meet(a, b) & in_a[:, :, None] & in_b[:, None, :]).nonzero().unbind(1)
    value = iou(a[view, i].double(), b[view, j].double())
    hit = value > above
    return view[hit], i[hit], j[hit], value[hit]


def suppressed(boxes: Float[Tensor, "V K 5"], there: Bool[Tensor, "V K"], above: float) -> Bool[Tensor, "V K"]:
    """Which rows stay in greedy non-maximum suppression; rows are sorted, best score first.

    A row stays unless its IoU with a better one that stays exceeds `above`. All rows are decided together, again and
    again, until nothing changes: after n rounds the fate of the n best rows is settled, and mostly that of all.

    Raises:
        ValueError: a box that counts is not finite.
    """
    if not bool(torch.isfinite(boxes[there]).all()):
        raise ValueError("boxes must be finite: a NaN or infinity is in them; drop those rows first")
    count = boxes.shape[1]
    view, better, worse, _ = overlaps(boxes, boxes, there, there, above)
    down = better < worse
    view, better, worse = view[down], better[down], worse[down]
    stays = there
    for _ in range(count):
        loses = torch.zeros_like(there, dtype=torch.int32)
        loses.index_put_((view, worse), stays[view, better].to(torch.int32), accumulate=True)
        decided = there & (loses == 0)
        if torch.equal(decided, stays):
            break
        stays = decided
    return stays


def iou(a: Float[Tensor, "P 5"], b: Float[Tensor, "P 5"]) -> Float[Tensor, " P"]:
    """Intersection over union of pairs of boxes; see `geometry.boxes.rotated_iou`."""
    area_a, area_b = a[:, 2] * a[:, 3], b[:, 2] * b[:, 3]
    shared = _intersection(a.T, b.T).clamp(min=0.0).minimum(torch.minimum(area_a, area_b))
    share = shared / (area_a + area_b - shared).clamp(min=_SMALLEST)
    return share * (share > _ROUNDING)


def _intersection(a: Float[Tensor, "5 P"], b: Float[Tensor, "5 P"]) -> Float[Tensor, " P"]:
    """The area shared by each pair: the integral of clamp(x) d clamp(y) along b's outline, in a's frame."""
    cos, sin = torch.cos(a[4]), torch.sin(a[4])
    east, north = b[0] - a[0], b[1] - a[1]
    centre = torch.stack([cos * east + sin * north, cos * north - sin * east])[:, None]  # [axis, 1, pair]
    turn = b[4] - a[4]
    cos, sin = torch.cos(turn), torch.sin(turn)
    length, width = 0.5 * b[2], 0.5 * b[3]
    fore = torch.stack([cos * length, sin * length])[:, None]
    side = torch.stack([-sin * width, cos * width])[:, None]
    one, two, along, across = (a.new_tensor(signs)[:, None] for signs in (_FORE, _SIDE, _ALONG, _ACROSS))
    corner = one * fore + two * side + centre  # [axis, edge, pair]
    edge = along * fore + across * side
    half = 0.5 * a[2:4, None]
    advance = torch.copysign(edge.abs().clamp(min=_TINY), edge)
    first, second = (-half - corner) / advance, (half - corner) / advance
    enter, leave = torch.minimum(first, second), torch.maximum(first, second)
    begin, end = enter[1].clamp(0.0, 1.0), leave[1].clamp(0.0, 1.0)
    at = torch.stack([begin, _between(enter[0], begin, end), _between(leave[0], begin, end), end])
    x = _between(corner[0] + at * edge[0], -half[0], half[0])
    strips = (x[1:] + x[:-1]) * (at[1:] - at[:-1])
    return 0.5 * (edge[1] * strips.sum(0)).sum(0)


def _between(x: Tensor, low: Tensor, high: Tensor) -> Tensor:
    return torch.minimum(torch.maximum(x, low), high)


def _meet(a: Float[Tensor, "V A 5"], b: Float[Tensor, "V B 5"]) -> Bool[Tensor, "V A B"]:
    """Whether the circles around two boxes of a view meet."""
    a, b = a.double(), b.double()
    reach = 0.5 * (torch.hypot(a[..., 2], a[..., 3])[:, :, None] + torch.hypot(b[..., 2], b[..., 3])[:, None, :])
    east, north = (a[..., None, i] - b[:, None, :, i] for i in range(2))
    return east * east + north * north < reach * reach
