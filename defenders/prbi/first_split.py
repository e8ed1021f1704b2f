"""Divisions of a fleet of which nothing is known yet: the first abnormal frame of `Reading(first=...)`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def even_split(members: Sequence[int], rng: np.random.Generator) -> tuple[list[int], list[int]]:
    """Random groups, the first of a size drawn evenly from 1 to n - 1.

    Args:
        members: The vehicles to divide, two or more.
        rng: The stream of the draws.

    Returns:
        Both groups, in the order drawn. A single vehicle is not divided: the second group is empty.
    """
    drawn = rng.permutation(list(members)).tolist()
    size = int(rng.integers(1, max(len(drawn), 2)))
    return drawn[:size], drawn[size:]


def independent_split(members: Sequence[int], rng: np.random.Generator) -> tuple[list[int], list[int]]:
    """Random groups: each vehicle joins the first with probability 1/2, so either may be empty.

    Args:
        members: The vehicles to divide.
        rng: The stream of the draws.

    Returns:
        Both groups, in the order drawn.
    """
    drawn = rng.permutation(list(members)).tolist()
    heads = (rng.random(len(drawn)) < 0.5).tolist()
    return (
        [i for i, head in zip(drawn, heads, strict=True) if head],
        [i for i, head in zip(drawn, heads, strict=True) if not head],
    )
