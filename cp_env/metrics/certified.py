"""Certified recall: what no k attackers can hide from an ego that lets single views vote.

A box of the vote's output is one that at least k + 1 of the n single views contain, so every one of them is held by a
benign vehicle. A true vehicle that r single views find is output whatever k of the vehicles send if r - k >= k + 1,
which is r >= 2 k + 1. No attack, budget or seed enters; the ego may be malicious. The bound holds for every rule that
counts members in this way, a median too.

The argument is this project's own, after certified majority votes (Levine and Feizi 2020, for one).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import ArrayLike

from cp_env.metrics.critical import found


def witnesses(views: Sequence[Float[np.ndarray, "_ 5"]], truth: Float[np.ndarray, "L 5"]) -> Int[np.ndarray, " L"]:
    """How many single views find each true vehicle (IoU of at least 0.5); boxes of each view, in one frame."""
    seen = np.array([found(boxes, truth) for boxes in views], dtype=np.intp).reshape(len(views), len(truth))
    counted: Int[np.ndarray, " L"] = seen.sum(axis=0)
    return counted


def certified_recall(counts: ArrayLike, k: int) -> float:
    """Share of the true vehicles with at least 2 k + 1 witnesses; 1 without a vehicle.

    Raises:
        ValueError: k below 0.
    """
    if k < 0:
        raise ValueError(f"k counts attackers and must be at least 0, not {k}")
    certified = is_certified(np.asarray(counts, dtype=np.intp), k)
    return float(certified.mean()) if certified.size else 1.0


def is_certified(counts: Int[np.ndarray, "*n"], k: int) -> Bool[np.ndarray, "*n"]:
    """Which vehicles no k attackers can hide; without an attacker, those that one view finds."""
    enough: Bool[np.ndarray, "*n"] = counts >= 2 * k + 1
    return enough
