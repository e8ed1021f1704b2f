"""Slow twins of `cp_env.geometry.boxes` and of two modules of `cp_env.metrics`: one pair, one cell at a time."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np

Point = tuple[float, float]


def outline(box: Sequence[float]) -> list[Point]:
    """Corners, counter-clockwise."""
    x, y, length, width, yaw = (float(number) for number in box)
    cos, sin = math.cos(yaw), math.sin(yaw)
    local = [(length / 2, width / 2), (-length / 2, width / 2), (-length / 2, -width / 2), (length / 2, -width / 2)]
    return [(x + cos * u - sin * v, y + sin * u + cos * v) for u, v in local]


def area(polygon: Sequence[Point]) -> float:
    """The shoelace formula."""
    pairs = zip(polygon, [*polygon[1:], *polygon[:1]], strict=True)
    return sum(x0 * y1 - x1 * y0 for (x0, y0), (x1, y1) in pairs) / 2


def clipped(polygon: list[Point], start: Point, end: Point) -> list[Point]:
    """What of the polygon lies left of the line from start to end (Sutherland and Hodgman)."""

    def side(p: Point) -> float:
        return (end[0] - start[0]) * (p[1] - start[1]) - (end[1] - start[1]) * (p[0] - start[0])

    kept: list[Point] = []
    for p, q in zip(polygon, [*polygon[1:], *polygon[:1]], strict=True):
        if side(p) >= 0:
            kept.append(p)
        if side(p) * side(q) < 0:
            share = side(p) / (side(p) - side(q))
            kept.append((p[0] + share * (q[0] - p[0]), p[1] + share * (q[1] - p[1])))
    return kept


def iou(a: Sequence[float], b: Sequence[float]) -> float:
    polygon, window = outline(a), outline(b)
    for start, end in zip(window, [*window[1:], *window[:1]], strict=True):
        polygon = clipped(polygon, start, end)
    shared = area(polygon) if polygon else 0.0
    union = float(a[2] * a[3] + b[2] * b[3]) - shared
    return shared / union if union > 0 else 0.0


def nms(boxes: np.ndarray, scores: np.ndarray, threshold: float) -> list[int]:
    kept: list[int] = []
    for row in sorted(range(len(boxes)), key=lambda r: -scores[r]):
        if all(iou(boxes[other], boxes[row]) <= threshold for other in kept):
            kept.append(row)
    return kept


def best_matching(table: np.ndarray, threshold: float) -> tuple[int, float]:
    """Most pairs above the threshold, and the largest summed IoU with that many, over all one-to-one assignments."""
    if len(table) > table.shape[1]:
        table = table.T
    best = (0, 0.0)
    for columns in itertools.permutations(range(table.shape[1]), len(table)):
        values = [v for v in (float(table[row, column]) for row, column in enumerate(columns)) if v > threshold]
        best = max(best, (len(values), math.fsum(values)))
    return best


def average_precision(frames: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]], threshold: float) -> float:
    """AP of frames (boxes, scores, truth): at each recall, the best precision of any score cut that reaches it."""
    n_truth = sum(len(truth) for _, _, truth in frames)
    points = []
    for least in sorted({float(s) for _, scores, _ in frames for s in scores}, reverse=True):
        right = found = 0
        for boxes, scores, truth in frames:
            free = list(range(len(truth)))
            for row in sorted(range(len(boxes)), key=lambda r: -scores[r]):
                if scores[row] < least:
                    continue
                found += 1
                best = max(free, key=lambda t: iou(boxes[row], truth[t]), default=None)
                if best is not None and iou(boxes[row], truth[best]) >= threshold:
                    free.remove(best)
                    right += 1
        points.append((right, right / found))
    if n_truth == 0:
        return 0.0 if points else 1.0
    return (
        sum(
            max((precision for right, precision in points if right >= needed), default=0.0)
            for needed in range(1, n_truth + 1)
        )
        / n_truth
    )


def agreement(p: np.ndarray, q: np.ndarray) -> float:
    """CCLoss of two maps on one grid, class by class and cell by cell."""
    above = below = 0.0
    for of_class in (lambda v: v, lambda v: 1 - v):
        shared = total = 0.0
        for u, v in zip(p.ravel().tolist(), q.ravel().tolist(), strict=True):
            shared += of_class(u) * of_class(v)
            total += of_class(u) + of_class(v)
        if total > 0:
            above += shared / total**2
            below += total / total**2
    return above / below
