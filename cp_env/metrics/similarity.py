"""Similarity of two views: of their boxes (PRBI, Eq. 5) and of their score maps (PASAC).

Convention: a view's boxes and map lie in the ego's grid frame of its own moment. Grid frames share the world's axes, so
the ego's motion is a translation: the older view is moved by `older.origin - newer.origin`. Two views are compared on
the ground both cover: what only one of them could show says nothing about whether they agree, so older boxes that
the motion carries out of range are dropped, and newer ones that were out of range then. Views without common ground
have similarity and agreement 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import ArrayLike
from scipy.optimize import linear_sum_assignment

from cp_env.geometry.boxes import overlaps
from cp_env.types import View


def match(a: ArrayLike, b: ArrayLike, iou: float = 0.5) -> Int[np.ndarray, "M 2"]:
    """One-to-one pairs (row of a, row of b) of boxes [A, 5] and [B, 5] whose IoU exceeds `iou`, ordered by row of a.

    Where a box has several candidates the pairs are chosen together (Hungarian method): as many pairs as possible and,
    of those choices, the one of largest summed IoU.

    Raises:
        ValueError: boxes that are not [L, 5], not finite or of negative size; `iou` not in [0, 1).
    """
    _, i, j = _matched([a], [b], iou)
    return np.stack([i, j], axis=1)


def jaccard(a: ArrayLike, b: ArrayLike, iou: float = 0.5) -> float:
    """Jaccard similarity of two sets of boxes in one frame, PRBI Eq. (5); see `jaccard_many`."""
    return float(jaccard_many([a], [b], iou)[0])


def jaccard_many(a: Sequence[ArrayLike], b: Sequence[ArrayLike], iou: float = 0.5) -> Float[np.ndarray, " V"]:
    """|M| / (|a| + |b| - |M|) of the boxes `a[v]` [A_v, 5] and `b[v]` [B_v, 5], PRBI Eq. (5), for all v in one go.

    M are the pairs of `match`. Two empty sets have similarity 1; an empty one and another have 0.
    """
    view, _, _ = _matched(a, b, iou)
    pairs = np.bincount(view, minlength=len(a))
    union = np.array([np.size(x) // 5 + np.size(y) // 5 for x, y in zip(a, b, strict=True)], dtype=np.intp) - pairs
    return np.where(union > 0, pairs / np.maximum(union, 1), 1.0)


def view_similarity(a: View, b: View, iou: float = 0.5, *, extent: float = 32.0) -> float:
    """Jaccard similarity of the boxes seen in two views, PRBI Eq. (5); see `view_similarity_many`."""
    return float(view_similarity_many([(a, b)], iou, extent=extent)[0])


def view_similarity_many(
    pairs: Sequence[tuple[View, View]], iou: float = 0.5, *, extent: float = 32.0
) -> Float[np.ndarray, " V"]:
    """Jaccard similarity of the boxes (`seen`) of pairs of views, on their common ground, the ego's motion taken out.

    `extent` is the detector's range in metres: a view covers |x|, |y| <= extent. Symmetric in each pair.
    """
    if not pairs:
        return np.zeros(0)
    a, b = ([view.seen.boxes for view in side] for side in zip(*pairs, strict=True))
    older, newer = (np.array([view.origin for view in side], dtype=np.float64) for side in zip(*pairs, strict=True))
    motion = older - newer  # b_T_a
    if motion.any():
        still = np.asarray((motion == 0).all(axis=1))
        a, _ = _inside(a, motion, still, extent)
        b = _inside(b, -motion, still, extent)[1]
    values = jaccard_many(a, b, iou)
    return np.where((np.abs(motion) >= 2 * extent).any(axis=1), 0.0, values)


def agreement(a: View, b: View, *, extent: float = 32.0) -> float:
    """Consistency of two views' score maps, PASAC's CCLoss, in [0, 0.5]: higher is more consistent.

    The classes j are vehicle (p) and background (1 - p). With P_j, Q_j the sums of the two maps over their common
    ground and w_j = 1 / (P_j + Q_j)², the value is Σ_j w_j Σ_cells p_j q_j / Σ_j w_j (P_j + Q_j); a class absent from
    both maps is left out. The older map is moved by the ego's motion to the nearest whole cell, exactly so for grids on
    one lattice (`geometry.grid_origin`): nothing is interpolated and no peak flattened. `extent` is the map's range, m.

    Raises:
        ValueError: the maps differ in shape.
    """
    if a.score_map.shape != b.score_map.shape:
        raise ValueError(f"score maps of one detector have one shape; got {a.score_map.shape} and {b.score_map.shape}")
    older, newer = (a, b) if a.frame <= b.frame else (b, a)
    height, width = newer.score_map.shape
    cells = (older.origin - newer.origin) * (width, height) / (2 * extent)  # by which what stands still has moved
    right, up = np.rint(cells).astype(int)
    if abs(right) >= width or abs(up) >= height:
        return 0.0
    p = older.score_map[max(-up, 0) : height - max(up, 0), max(-right, 0) : width - max(right, 0)].astype(np.float64)
    q = newer.score_map[max(up, 0) : height - max(-up, 0), max(right, 0) : width - max(-right, 0)].astype(np.float64)
    shared = np.array([np.vdot(p, q), np.vdot(1 - p, 1 - q)])
    total = np.array([p.sum() + q.sum(), (1 - p).sum() + (1 - q).sum()])
    present = total > 0
    return float((shared[present] / total[present] ** 2).sum() / (1 / total[present]).sum())


def _inside(
    sets: Sequence[Float[np.ndarray, "_ 5"]],
    motion: Float[np.ndarray, "V 2"],
    still: Bool[np.ndarray, " V"],
    extent: float,
) -> tuple[list[Float[np.ndarray, "_ 5"]], list[Float[np.ndarray, "_ 5"]]]:
    """The boxes of each view that are in the other's range after the motion: moved, and as they were.

    Where nothing moves, all boxes are.
    """
    count = np.array([len(boxes) for boxes in sets])
    before, view = np.concatenate(sets).astype(np.float64), np.repeat(np.arange(len(sets)), count)
    after = before.copy()
    after[:, :2] += motion[view]
    inside = (np.abs(after[:, :2]) <= extent).all(axis=1) | still[view]
    after, before = after[inside], before[inside]
    ends = [0, *np.cumsum(np.bincount(view[inside], minlength=len(sets))).tolist()]
    return [after[i:j] for i, j in pairwise(ends)], [before[i:j] for i, j in pairwise(ends)]


def _matched(
    a: Sequence[ArrayLike], b: Sequence[ArrayLike], iou: float
) -> tuple[Int[np.ndarray, " M"], Int[np.ndarray, " M"], Int[np.ndarray, " M"]]:
    """Matched pairs of all sets: arrays (v, row in a[v], row in b[v])."""
    if not 0 <= iou < 1:
        raise ValueError(f"iou is the overlap a match must exceed, in [0, 1); got {iou}")
    view, i, j, value = overlaps(a, b, above=iou)
    if not len(view):
        return view, i, j
    alone_i = _occurrences(view * (i.max() + 1) + i) == 1
    keep = alone_i & (_occurrences(view * (j.max() + 1) + j) == 1)
    if keep.all():
        return view, i, j
    contested = np.flatnonzero(~keep)
    for v in np.unique(view[contested]):
        rows = contested[view[contested] == v]
        keep[rows[_hungarian(i[rows], j[rows], value[rows])]] = True
    return view[keep], i[keep], j[keep]


def _occurrences(keys: Int[np.ndarray, " P"]) -> Int[np.ndarray, " P"]:
    """How often each entry occurs."""
    return np.bincount(keys)[keys]


def _hungarian(
    i: Int[np.ndarray, " P"], j: Int[np.ndarray, " P"], value: Float[np.ndarray, " P"]
) -> Int[np.ndarray, " M"]:
    """Which of the pairs (i, j) make a largest one-to-one matching, and of those the one of largest summed value."""
    rows, i = np.unique(i, return_inverse=True)
    columns, j = np.unique(j, return_inverse=True)
    pair = np.full((len(rows), len(columns)), -1)
    pair[i, j] = np.arange(len(i))
    gain = np.zeros(pair.shape)
    gain[i, j] = min(pair.shape) + 1 + value  # one pair more outweighs any sum of values, each at most 1
    chosen = pair[linear_sum_assignment(gain, maximize=True)]
    return chosen[chosen >= 0]
