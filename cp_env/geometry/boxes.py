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

# One box's outline: corner = centre + FORE * half length vector + SIDE * half width vector, and the edge to the next.
_FORE = np.array([1.0, -1.0, -1.0, 1.0])[:, None]
_SIDE = np.array([1.0, 1.0, -1.0, -1.0])[:, None]
_ALONG = np.array([-2.0, 0.0, 2.0, 0.0])[:, None]
_ACROSS = np.array([0.0, -2.0, 0.0, 2.0])[:, None]
_TINY = 1e-150  # m; in place of zero where an edge does not advance along an axis
_BLOCK = 512  # pairs computed together: their arrays stay in the processor's cache, which halves the time
_NEAR_BLOCK = 1 << 15  # likewise: distances computed together
_ROUNDING = 1e-14  # an IoU up to this is what rounding leaves of none
_SMALLEST = float(np.finfo(np.float64).tiny)


def rotated_iou(a: ArrayLike, b: ArrayLike) -> Float[np.ndarray, "*n"]:
    """Intersection over union of each box of `a` [*n, 5] with its partner in `b` [*n, 5], in [0, 1].

    Leading axes broadcast. A box without area has IoU 0 with everything, itself included.

    Raises:
        ValueError: an entry is not finite, a length or width is negative, or the last axis is not 5.
    """
    a, b = np.broadcast_arrays(checked(a), checked(b))
    return _iou(a.reshape(-1, 5), b.reshape(-1, 5)).reshape(a.shape[:-1])


def pairwise_iou(a: ArrayLike, b: ArrayLike) -> Float[np.ndarray, "A B"]:
    """IoU of every box of `a` [A, 5] with every box of `b` [B, 5]. Raises ValueError as `rotated_iou` does."""
    a, b = checked(a, ndim=2), checked(b, ndim=2)
    table = np.zeros((len(a), len(b)))
    i, j = np.nonzero(_near(_disc(a)[None], _disc(b)[None])[0])
    table[i, j] = _iou(a[i], b[j])
    return table


def overlaps(
    a: Sequence[ArrayLike], b: Sequence[ArrayLike], above: float = 0.0
) -> tuple[Int[np.ndarray, " P"], Int[np.ndarray, " P"], Int[np.ndarray, " P"], Float[np.ndarray, " P"]]:
    """The pairs of `a[v]` [A_v, 5] with `b[v]` [B_v, 5] whose IoU exceeds `above`, for all v in one go.

    Arrays (v, row in a[v], row in b[v], IoU), ordered by v, then row in a[v], then row in b[v].

    Raises:
        ValueError: as `rotated_iou`, or the two sequences differ in length.
    """
    if len(a) != len(b):
        raise ValueError(
            f"a[v] is compared with b[v], so give as many of each; got {len(a)} and {len(b)} sets of boxes"
        )
    disc_a, flat_a, start_a = _stack(a)
    disc_b, flat_b, start_b = _stack(b)
    view, i, j = _nonzero(_near(disc_a, disc_b))
    iou = _iou(flat_a[start_a[view] + i], flat_b[start_b[view] + j])
    hit = np.flatnonzero(iou > above)
    return view[hit], i[hit], j[hit], iou[hit]


def nms(boxes: ArrayLike, scores: ArrayLike, iou: float) -> Int[np.ndarray, " K"]:
    """Rows of the boxes [L, 5] with scores [L] that stay, best score first; see `nms_batch`."""
    scores = np.asarray(scores)
    return nms_batch(boxes, scores, np.zeros(scores.shape, dtype=np.intp), iou)


def nms_batch(boxes: ArrayLike, scores: ArrayLike, views: ArrayLike, iou: float) -> Int[np.ndarray, " K"]:
    """Greedy non-maximum suppression in each view by itself, all views in one call.

    Best score first (of equal scores the earlier row), a box stays unless its IoU with one that stayed exceeds `iou`.
    `views` [L] says which view a row of `boxes` [L, 5] and `scores` [L] belongs to: small whole numbers, in any order.
    Returns the rows that stay, by view and within a view best score first.

    Raises:
        ValueError: as `rotated_iou`; a score is NaN; lengths differ; a view number is negative; `iou` not in [0, 1].
    """
    boxes, scores, views = checked(boxes, ndim=2), np.asarray(scores), np.asarray(views)
    if not 0 <= iou <= 1:
        raise ValueError(f"iou is a share of area in [0, 1]; got {iou}")
    if scores.shape != (len(boxes),) or views.shape != (len(boxes),):
        raise ValueError(
            f"{len(boxes)} boxes need as many scores and view numbers; got {scores.shape} and {views.shape}"
        )
    if not len(boxes):
        return np.zeros(0, dtype=np.intp)
    if np.isnan(scores).any():
        raise ValueError("scores must not be NaN: drop such boxes before the suppression")
    if views.min() < 0:
        raise ValueError(f"view numbers count from 0; got {views.min()}")
    order = np.lexsort((-scores, views))
    ranked, views = boxes[order], views[order]
    count = np.bincount(views)
    disc, start = _pad(_disc(ranked), views, count)
    near = _near(disc, disc)
    near &= np.tri(near.shape[1], k=-1, dtype=bool).T  # the better box first
    view, i, j = _nonzero(near)
    i, j = start[view] + i, start[view] + j
    close = _iou(ranked[i], ranked[j]) > iou
    stays = [True] * len(ranked)
    for better, worse in np.stack([i[close], j[close]], axis=1).tolist():  # by `better`, whose fate is settled by now
        if stays[better]:
            stays[worse] = False
    return order[stays]


def checked(boxes: ArrayLike, ndim: int | None = None) -> Float[np.ndarray, "*n 5"]:
    """The boxes as float64, or a ValueError that says what is wrong with them. An empty list is no boxes."""
    array = np.asarray(boxes, dtype=np.float64)
    if array.shape == (0,):
        array = array.reshape(0, 5)
    if array.ndim == 0 or array.shape[-1] != 5 or (ndim is not None and array.ndim != ndim):
        wanted = "[..., 5]" if ndim is None else "[L, 5]"
        raise ValueError(
            f"boxes are rows (x, y, length, width, yaw), so their shape must be {wanted}; got {array.shape}"
        )
    if not np.isfinite(array).all():
        raise ValueError("boxes must be finite: a NaN or infinity is in them; drop those rows first")
    if array.size and array[..., 2:4].min() < 0:
        raise ValueError(f"lengths and widths must not be negative; got {array[..., 2:4].min()}")
    return array


def _iou(a: Float[np.ndarray, "P 5"], b: Float[np.ndarray, "P 5"]) -> Float[np.ndarray, " P"]:
    """IoU of pairs, 0 where neither has an area."""
    if len(a) > _BLOCK:
        return np.concatenate([_iou(a[k : k + _BLOCK], b[k : k + _BLOCK]) for k in range(0, len(a), _BLOCK)])
    a, b = np.ascontiguousarray(a.T), np.ascontiguousarray(b.T)
    area_a, area_b = a[2] * a[3], b[2] * b[3]
    shared = _clamp(_intersection(a, b), 0.0, np.minimum(area_a, area_b))
    share = shared / np.maximum(area_a + area_b - shared, _SMALLEST)
    share *= share > _ROUNDING
    return share


def _intersection(a: Float[np.ndarray, "5 P"], b: Float[np.ndarray, "5 P"]) -> Float[np.ndarray, " P"]:
    """The area shared by each pair, m²: the integral of clamp(x) d clamp(y) along b's outline, in a's frame."""
    cos, sin = np.cos(a[4]), np.sin(a[4])
    east, north = b[:2] - a[:2]
    centre, fore, side = np.empty((3, 2, 1, a.shape[1]))  # of b: centre, half length and half width as vectors
    centre[0, 0] = cos * east + sin * north
    centre[1, 0] = cos * north - sin * east
    turn = b[4] - a[4]
    cos, sin = np.cos(turn), np.sin(turn)
    half = 0.5 * b[2:4]
    fore[0, 0], fore[1, 0] = cos * half[0], sin * half[0]
    side[0, 0], side[1, 0] = -sin * half[1], cos * half[1]
    corner = _FORE * fore + _SIDE * side
    corner += centre  # [axis, edge, pair]
    edge = _ALONG * fore + _ACROSS * side
    half = 0.5 * a[2:4, None]

    # Where along each edge (0 to 1) it enters and leaves a's extent, per axis.
    advance = np.copysign(np.maximum(np.abs(edge), _TINY), edge)
    first, second = (-half - corner) / advance, (half - corner) / advance
    enter, leave = np.minimum(first, second), np.maximum(first, second)
    at = np.empty((4, *edge.shape[1:]))
    at[0], at[3] = _clamp(enter[1], 0.0, 1.0), _clamp(leave[1], 0.0, 1.0)  # clamp(y) moves between these
    at[1], at[2] = _clamp(enter[0], at[0], at[3]), _clamp(leave[0], at[0], at[3])  # clamp(x) bends at these
    x = _clamp(corner[0] + at * edge[0], -half[0], half[0])
    strips = (x[1:] + x[:-1]) * (at[1:] - at[:-1])
    return 0.5 * (edge[1] * strips.sum(axis=0)).sum(axis=0)


def _clamp(x: np.ndarray, low: np.ndarray | float, high: np.ndarray | float) -> np.ndarray:
    """np.clip without its overhead, which outweighs the work on arrays this small."""
    return np.minimum(np.maximum(x, low), high)


def _disc(boxes: Float[np.ndarray, "L 5"]) -> Float[np.ndarray, "L 3"]:
    """The circle around each box: x, y, radius."""
    disc = boxes[:, :3].copy()
    disc[:, 2] = 0.5 * np.hypot(boxes[:, 2], boxes[:, 3])
    return disc


def _near(a: Float[np.ndarray, "V A 3"], b: Float[np.ndarray, "V B 3"]) -> Bool[np.ndarray, "V A B"]:
    """Whether two discs meet; NaN meets nothing."""
    views = max(_NEAR_BLOCK // max(a.shape[1] * b.shape[1], 1), 1)
    if len(a) > views:
        return np.concatenate([_near(a[k : k + views], b[k : k + views]) for k in range(0, len(a), views)])
    distance = a[:, :, None, 0] - b[:, None, :, 0]
    north = a[:, :, None, 1] - b[:, None, :, 1]
    reach = a[:, :, None, 2] + b[:, None, :, 2]
    distance *= distance
    north *= north
    reach *= reach
    distance += north
    return distance < reach


def _nonzero(
    mask: Bool[np.ndarray, "V A B"],
) -> tuple[Int[np.ndarray, " P"], Int[np.ndarray, " P"], Int[np.ndarray, " P"]]:
    """Indices of the true entries, in order (several times as fast as np.nonzero on three axes)."""
    flat = np.flatnonzero(mask)
    rest, j = np.divmod(flat, max(mask.shape[2], 1))
    view, i = np.divmod(rest, max(mask.shape[1], 1))
    return view, i, j


def _pad(
    discs: Float[np.ndarray, "L 3"], views: Int[np.ndarray, " L"], count: Int[np.ndarray, " V"]
) -> tuple[Float[np.ndarray, "V K 3"], Int[np.ndarray, " V"]]:
    """Discs, sorted by view, side by side with NaN where a view has fewer; and the row where each view starts."""
    start = np.cumsum(count) - count
    if len(count) == 1:
        return discs[None], start
    padded = np.full((len(count), int(count.max(initial=0)), 3), np.nan)
    padded[views, np.arange(len(discs)) - start[views]] = discs
    return padded, start


def _stack(
    sets: Sequence[ArrayLike],
) -> tuple[Float[np.ndarray, "V K 3"], Float[np.ndarray, "L 5"], Int[np.ndarray, " V"]]:
    """All sets together: their discs padded to one size, their boxes one after the other, the row where each starts."""
    rows = all(isinstance(boxes, np.ndarray) and boxes.shape[1:] == (5,) for boxes in sets)
    arrays: Sequence[np.ndarray] = sets if rows else [checked(boxes, ndim=2) for boxes in sets]  # type: ignore[assignment]
    flat = checked(np.concatenate(arrays), ndim=2) if len(arrays) else np.zeros((0, 5))  # all at once: many are quicker
    count = np.array([len(boxes) for boxes in arrays], dtype=np.intp)
    disc, start = _pad(_disc(flat), np.repeat(np.arange(len(count)), count), count)
    return disc, flat, start
