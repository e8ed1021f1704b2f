"""Likelihoods that nobody measured."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np

from defenders.bayes.histograms import Calibrated
from defenders.bayes.likelihood import attackers_in_groups, attackers_in_one, overlaps


def made_up(seed: int, *, most: int = 3, bins: int = 4, modes: int = 2) -> Calibrated:
    """Densities as wild as they may be."""
    rng = np.random.default_rng(seed)

    def rows(kinds: list[Any], bins: int = bins) -> dict[Any, np.ndarray]:
        return dict(zip(kinds, rng.dirichlet(np.ones(bins), len(kinds)), strict=True))

    pairs = list(product(range(1, most + 1), repeat=2))
    return Calibrated(
        np.linspace(0, 1, bins + 1),
        [rows(overlaps(most)) for _ in range(2)],
        [rows(attackers_in_one(most)) for _ in range(modes)],
        [rows(pairs) for _ in range(modes)],
        np.linspace(0, 1, 4),
        [rows(attackers_in_groups(most), 3) for _ in range(modes)],
        tail=0.05,
    )
