"""Overlap of oriented boxes, exact, and non-maximum suppression; numpy, many views in one call.

Convention: a box is (x, y, length, width, yaw), metres and radians; all boxes of one view share one frame.

How the overlap is computed: seen from box a, a is |x| <= l/2, |y| <= w/2, and by Green's theorem the area it shares
with polygon b is the integral of clamp(x) d clamp(y) along the outline of b. Along an edge both clamps are linear
between at most four breakpoints, so the trapezoid rule is exact. Nothing is decided (inside or outside, parallel or
not): the area is a continuous function of the numbers, so boxes that coincide, touch or contain each other are no
special cases. Few pairs are near enough to overlap; only those are computed, for all views together.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import ArrayLike

Boxes = Float[np.ndarray, "L 5"]

# One box's outline: corner = centre + FORE * half length vector + SIDE * half width vector, and the edge to the next.
_FORE = np.array([1.0, -1.0, -1.0, 1.0])[:, None]
_SIDE = np.array([1.0, 1.0, -1.0, -1.0])[:, None]
_ALONG = np.array([-2.0, 0.0, 2.0, 0.0])[:, None]
_ACROSS = np.array([0.0, -2.0, 0.0, 2.0])[:, None]
_TINY = 1e-30  # m; an edge shorter than this along an axis does not advance along it


def rotated_iou(a: Float[ArrayLike, "*n 5"], b: Float[ArrayLike, "*n 5"]) -> Float[np.ndarray, "*n"]:
    """Intersection over union of each box of `a` with its partner in `b`, in [0, 1]; leading axes broadcast.

    A box without area has IoU 0 with everything, itself included.

    Raises:
        ValueError: an entry is not finite, a length or width is negative, or the last axis is not 5.
    """
    a, b = np.broadcast_arrays(checked(a), checked(b))
    return _iou(a.reshape(-1, 5), b.reshape(-1, 5)).reshape(a.shape[:-1])


def pairwise_iou(a: Float[ArrayLike, "A 5"], b: Float[ArrayLike, "B 5"]) -> Float[np.ndarray, "A B"]:
    """IoU of every box of `a` with every box of `b`. Raises ValueError as `rotated_iou` does."""
    a, b = checked(a, ndim=2), checked(b, ndim=2)
    table = np.zeros((len(a), len(b)))
    if table.size:
        i, j = np.nonzero(_near(_disc(a), _disc(b)))
        table[i, j] = _iou(a[i], b[j])
    return table


def overlaps(
    a: Sequence[Float[ArrayLike, "A 5"]], b: Sequence[Float[ArrayLike, "B 5"]]
) -> tuple[Int[np.ndarray, " P"], Int[np.ndarray, " P"], Int[np.ndarray, " P"], Float[np.ndarray, " P"]]:
    """The overlapping pairs of `a[v]` with `b[v]`, for all v in one go: arrays (v, row in a[v], row in b[v], IoU).

    Ordered by v, then row in a[v], then row in b[v]; pairs that share no area are left out.

    Raises:
        ValueError: as `rotated_iou`, or the two sequences differ in length.
    """
    if len(a) != len(b):
        raise ValueError(f"overlaps compares a[v] with b[v]: got {len(a)} and {len(b)} sets of boxes; give as many of each")
    disc_a, flat_a, start_a = _stack(a)
    disc_b, flat_b, start_b = _stack(b)
    view, i, j = _nonzero(_near(disc_a, disc_b))
    iou = _iou(flat_a[start_a[view] + i], flat_b[start_b[view] + j])
    hit = np.flatnonzero(iou > 0)
    return view[hit], i[hit], j[hit], iou[hit]


def nms(boxes: Float[ArrayLike, "L 5"], scores: Float[ArrayLike, " L"], iou: float) -> Int[np.ndarray, " K"]:
    """Rows of the boxes that stay, best score first; see `nms_batch`."""
    return nms_batch(boxes, scores, np.zeros(len(np.asarray(scores)), dtype=np.intp), iou)


def nms_batch(
    boxes: Float[ArrayLike, "L 5"], scores: Float[ArrayLike, " L"], views: Int[ArrayLike, " L"], iou: float
) -> Int[np.ndarray, " K"]:
    """Greedy non-maximum suppression in each view by itself, all views in one call.

    Best score first (of equal scores the earlier row), a box stays unless its IoU with one that stayed exceeds `iou`.
    `views` says which view a row belongs to: small whole numbers, in any order. Returns the rows that stay, by view and
    within a view best score first.

    Raises:
        ValueError: as `rotated_iou`; a score is NaN; lengths differ; a view number is negative; `iou` not in [0, 1].
    """
    boxes, scores, views = checked(boxes, ndim=2), np.asarray(scores), np.asarray(views)
    if not 0 <= iou <= 1:
        raise ValueError(f"iou is a share of area in [0, 1]; got {iou}")
    if scores.shape != (len(boxes),) or views.shape != (len(boxes),):
        raise ValueError(f"one score and one view number a box: got {scores.shape} and {views.shape} for {len(boxes)} boxes")
    if not len(boxes):
        return np.zeros(0, dtype=np.intp)
    if np.isnan(scores).any():
        raise ValueError("scores must not be NaN: drop such boxes before the suppression")
    if views.min() < 0:
        raise ValueError(f"view numbers count from 0; got {views.min()}")
    order = np.lexsort((-scores, views))
    ranked, views = boxes[order], views[order]
    count = np.bincount(views)
    start = np.cumsum(count) - count
    disc = _pad(_disc(ranked), views, np.arange(len(ranked)) - start[views], (len(count), int(count.max())))
    near = _near(disc, disc)
    near &= np.tri(near.shape[1], k=-1, dtype=bool).T  # the better box first
    view, i, j = _nonzero(near)
    i, j = start[view] + i, start[view] + j
    close = _iou(ranked[i], ranked[j]) > iou
    stays = [True] * len(ranked)
    for better, worse in zip(i[close].tolist(), j[close].tolist()):  # ordered by `better`, whose fate is settled by now
        if stays[better]:
            stays[worse] = False
    return order[stays]


def checked(boxes: Float[ArrayLike, "*n 5"], ndim: int | None = None) -> Float[np.ndarray, "*n 5"]:
    """The boxes as float64, or a ValueError that says what is wrong with them. An empty list is no boxes."""
    array = np.asarray(boxes, dtype=np.float64)
    if array.shape == (0,):
        array = array.reshape(0, 5)
    if array.ndim == 0 or array.shape[-1] != 5 or (ndim is not None and array.ndim != ndim):
        raise ValueError(f"boxes are rows (x, y, length, width, yaw): the shape must be [..., 5]; got {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError("boxes must be finite: a NaN or infinity is in them; drop those rows first")
    if array.size and array[..., 2:4].min() < 0:
        raise ValueError(f"lengths and widths must not be negative; got {array[..., 2:4].min()}")
    return array


def _iou(a: Float[np.ndarray, "P 5"], b: Float[np.ndarray, "P 5"]) -> Float[np.ndarray, " P"]:
    """IoU of pairs, 0 where neither has an area."""
    shared = _intersection(np.ascontiguousarray(a.T), np.ascontiguousarray(b.T))
    area_a, area_b = a[:, 2] * a[:, 3], b[:, 2] * b[:, 3]
    shared = np.clip(shared, 0.0, np.minimum(area_a, area_b))  # rounding only
    union = area_a + area_b - shared
    return shared / np.where(union > 0, union, 1.0)


def _intersection(a: Float[np.ndarray, "5 P"], b: Float[np.ndarray, "5 P"]) -> Float[np.ndarray, " P"]:
    """The area shared by each pair, m²: the integral of clamp(x) d clamp(y) along b's outline, in a's frame."""
    cos_sin = np.cos(a[4]), np.sin(a[4])
    offset = b[:2] - a[:2]
    turn = b[4] - a[4]
    cos, sin = np.cos(turn), np.sin(turn)
    half = 0.5 * a[2:4, None]  # [2, 1, P]
    fore = 0.5 * b[2] * np.stack([cos, sin])[:, None]  # b's half length and half width as vectors, [2, 1, P]
    side = 0.5 * b[3] * np.stack([-sin, cos])[:, None]
    centre = np.stack(
        [cos_sin[0] * offset[0] + cos_sin[1] * offset[1], cos_sin[0] * offset[1] - cos_sin[1] * offset[0]]
    )[:, None]
    corner = centre + _FORE * fore + _SIDE * side  # [axis, edge, P]
    edge = _ALONG * fore + _ACROSS * side

    # Where along each edge (0 to 1) it enters and leaves a's extent, per axis.
    per_step = 1.0 / np.where(np.abs(edge) < _TINY, _TINY, edge)
    first, second = (-half - corner) * per_step, (half - corner) * per_step
    enter, leave = np.minimum(first, second), np.maximum(first, second)
    begin, end = np.clip(enter[1], 0.0, 1.0), np.clip(leave[1], 0.0, 1.0)  # clamp(y) moves between these
    at = np.stack([begin, np.clip(enter[0], begin, end), np.clip(leave[0], begin, end), end])  # clamp(x) bends at these
    x = corner[0] + at * edge[0]
    x = np.clip(x, -half[0], half[0])
    return 0.5 * (edge[1] * ((x[1:] + x[:-1]) * (at[1:] - at[:-1])).sum(axis=0)).sum(axis=0)


def _disc(boxes: Float[np.ndarray, "*n 5"]) -> Float[np.ndarray, "*n 3"]:
    """The circle around each box: x, y, radius."""
    radius = 0.5 * np.hypot(boxes[..., 2], boxes[..., 3])
    return np.concatenate([boxes[..., :2], radius[..., None]], axis=-1)


def _near(a: Float[np.ndarray, "*v A 3"], b: Float[np.ndarray, "*v B 3"]) -> Bool[np.ndarray, "*v A B"]:
    """Whether two discs meet; NaN meets nothing."""
    x = a[..., :, None, 0] - b[..., None, :, 0]
    y = a[..., :, None, 1] - b[..., None, :, 1]
    reach = a[..., :, None, 2] + b[..., None, :, 2]
    return x * x + y * y < reach * reach


def _nonzero(
    mask: Bool[np.ndarray, "V A B"],
) -> tuple[Int[np.ndarray, " P"], Int[np.ndarray, " P"], Int[np.ndarray, " P"]]:
    """Indices of the true entries, in order (several times as fast as np.nonzero on three axes)."""
    flat = np.flatnonzero(mask)
    rest, j = np.divmod(flat, max(mask.shape[2], 1))
    view, i = np.divmod(rest, max(mask.shape[1], 1))
    return view, i, j


def _pad(
    discs: Float[np.ndarray, "L 3"], views: Int[np.ndarray, " L"], places: Int[np.ndarray, " L"], shape: tuple[int, int]
) -> Float[np.ndarray, "V K 3"]:
    """Discs at [view, place]; NaN elsewhere."""
    padded = np.full((*shape, 3), np.nan)
    padded[views, places] = discs
    return padded


def _stack(
    sets: Sequence[Float[ArrayLike, "L 5"]],
) -> tuple[Float[np.ndarray, "V K 3"], Float[np.ndarray, "N 5"], Int[np.ndarray, " V"]]:
    """All sets together: discs padded to [V, K, 3], boxes [N, 5] one set after the other, where each set starts."""
    arrays = [np.asarray(boxes).reshape(-1, 5) if np.size(boxes) == 0 else np.asarray(boxes) for boxes in sets]
    flat = checked(np.concatenate(arrays) if arrays else np.zeros((0, 5)), ndim=2)
    count = np.array([len(boxes) for boxes in arrays], dtype=np.intp)
    start = np.cumsum(count) - count
    views = np.repeat(np.arange(len(count)), count)
    disc = _pad(_disc(flat), views, np.arange(len(flat)) - start[views], (len(count), int(count.max(initial=0))))
    return disc, flat, start
