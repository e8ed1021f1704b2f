"""Mean similarities by the densities that ship for `bayes`, of groups by their size and the attackers in them.

    python examples/reproduce/density_means.py
    python examples/reproduce/density_means.py --fusion max

The densities are histograms that were measured on calibration scenes; `examples/calibrate_likelihood.py` measures them
anew. A mean is that of the middles of their bins. The first table compares a group's view with the benign view of all
five vehicles in the frame before, the second with the full view of the same frame, which holds k attackers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from cp_env.settings import Fusion
from defenders.bayes.likelihood import attackers_in_groups, attackers_in_one, overlaps
from defenders.calibration.files import DENSITIES
from defenders.calibration.lookup import calibration_for

MODES = ("loud", "stealthy")
Means = dict[tuple[int, int, int], float]


@dataclass(frozen=True)
class Args:
    fusion: Fusion = "mean"


def means(rows: Sequence[Sequence[float]], edges: Sequence[float], kinds: Sequence[tuple[int, int, int]]) -> Means:
    """The mean of each histogram, by its kind."""
    middles = (np.array(edges[1:]) + np.array(edges[:-1])) / 2
    return {kind: float(np.dot(row, middles)) for kind, row in zip(kinds, rows, strict=True)}


def to_the_frame_before(stored: Mapping[str, Any]) -> Table:
    """Similarity to the benign view of all vehicles in the frame before."""
    n, edges = stored["n_vehicles"], stored["edges"]
    benign = means(stored["uncontaminated"][0], edges, overlaps(n))
    attacked = [means(rows, edges, attackers_in_one(n)) for rows in stored["one_contaminated"]]
    columns = [(number, mode) for number in range(len(attacked)) for mode in range(1, n)]
    table = Table(
        "group size",
        "no attacker",
        *(f"{d} {MODES[mode]}" for mode, d in columns),
        title="to the benign view of all, a frame before",
    )
    for size in range(1, n + 1):
        cells = [
            "–" if d > size else f"{attacked[mode][size, d, n]:.2f}"  # a group has no more attackers than members
            for mode, d in columns
        ]
        table.add_row(str(size), f"{benign[size, n, size]:.2f}", *cells)
    return table


def to_the_full_view(stored: Mapping[str, Any], mode: int) -> Table:
    """Similarity to the view of all vehicles in the same frame, by k and by the attackers in the group."""
    n, kinds = stored["n_vehicles"], attackers_in_groups(stored["n_vehicles"])
    found = means(stored["full_view"][mode], stored["full_view_edges"], kinds)
    columns = [(k, d) for k in range(n) for d in (0, 1) if d <= k]
    table = Table(
        "group size",
        *(f"k = {k}, {d} in it" if k else "no attack" for k, d in columns),
        title=f"to the full view of the same frame, {MODES[mode]}",
    )
    for size in range(1, n):
        cells = [f"{found[size, d, k]:.2f}" if (size, d, k) in found else "–" for k, d in columns]
        table.add_row(str(size), *cells)
    return table


def main(args: Args) -> None:
    stored = calibration_for(args.fusion, DENSITIES).parts[DENSITIES]
    console = Console(width=150)
    console.print(stored["source"])
    console.print(to_the_frame_before(stored), *(to_the_full_view(stored, m) for m in range(len(stored["full_view"]))))


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
