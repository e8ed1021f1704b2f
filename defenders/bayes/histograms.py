"""Measured densities of similarities: histograms, a part of a detector's calibration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from hashlib import sha256
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from defenders.bayes.likelihood import (
    Likelihood,
    Row,
    Verifier,
    attackers_in_groups,
    attackers_in_one,
    overlaps,
    read_only,
)
from defenders.calibration.files import DENSITIES
from defenders.calibration.lookup import DEFAULT, calibration_for

FADES = 0.95  # share of its discrimination that a reference older than was measured keeps with every frame


class Calibrated(Likelihood):
    """Densities measured on calibration scenes, with heavy tails, for fleets of any size.

    Of every density a share `tail` is replaced by the mean of all. So no similarity, however unusual, favours one kind
    of comparison over another by more than a bounded ratio. Where nothing was measured:

    * An uncontaminated view of more vehicles than measured counts as one of the most measured, with the same share in
      common. So does an uncontaminated view that a contaminated one is compared with.
    * Against a full view of a size that was not measured, sizes and numbers of attackers count in proportion.
    * d attackers among more vehicles than measured, m, count as d m / size among m, rounded. Where that is below one,
      the perturbation may be too dilute to show: the density is that of one attacker among m with this weight, and of
      none with the rest.
    * Two attacks of different modes resemble each other as two attacks of the lower mode do.
    """

    def __init__(
        self,
        edges: Float[np.ndarray, " E"],
        uncontaminated: Sequence[Mapping[tuple[int, int, int], Row]],
        one_contaminated: Sequence[Mapping[tuple[int, int, int], Row]],
        both_contaminated: Sequence[Mapping[tuple[int, int], Row]],
        full_view_edges: Float[np.ndarray, " F"],
        full_view: Sequence[Mapping[tuple[int, int, int], Float[np.ndarray, " C"]]],
        *,
        tail: float,
    ) -> None:
        """Check the histograms and mix in the tails.

        Args:
            edges: Bounds of the bins of a similarity to a reference.
            uncontaminated: `uncontaminated[age - 1][size, reference, shared]`.
            one_contaminated: `one_contaminated[mode - 1][size, attackers, other]`.
            both_contaminated: `both_contaminated[mode - 1][size, other]`.
            full_view_edges: Bounds of the bins of a similarity to the full view.
            full_view: `full_view[mode - 1][size, attackers, total_attackers]`.
            tail: Share of every density that is the mean of all.

        Raises:
            ValueError: If a histogram is missing or is no histogram.
        """
        most = max((size for of in one_contaminated for size, _, _ in of), default=0)
        for bounds in (edges, full_view_edges):
            if not (bounds[0] == 0 and bounds[-1] == 1 and (np.diff(bounds) > 0).all()):
                raise ValueError(f"edges must rise from 0 to 1, got {bounds.tolist()}")
        if not 0 < tail < 1:
            raise ValueError(f"tail is the share of every density that is the mean of all, between 0 and 1, got {tail}")
        if not uncontaminated or any(set(of) != set(overlaps(most)) for of in uncontaminated):
            raise ValueError(
                f"uncontaminated views of every two groups of {most} vehicles must be measured; calibrate again"
            )
        if not len(one_contaminated) == len(both_contaminated) == len(full_view) or any(
            set(of) != set(attackers_in_one(most)) for of in one_contaminated
        ):
            raise ValueError(f"any number of attackers among {most} vehicles must be measured, in each mode")
        if any(set(of) != set(product(range(1, most + 1), repeat=2)) for of in both_contaminated):
            raise ValueError(
                f"contaminated views of all sizes up to {most} must be compared with each other; calibrate again"
            )
        if any(set(of) != set(attackers_in_groups(most)) for of in full_view):
            raise ValueError(
                f"views of all groups of {most} vehicles must be compared with the full view; calibrate again"
            )
        benign_rows, contaminated_rows = _stacked(uncontaminated), _stacked(one_contaminated)
        for cells in (
            np.concatenate([benign_rows, contaminated_rows, _stacked(both_contaminated)]),
            _stacked(full_view),
        ):
            if not (np.isfinite(cells).all() and (cells >= 0).all() and np.allclose(cells.sum(1), 1, atol=1e-3)):
                raise ValueError("every density must be a histogram that sums to one; calibrate again")
        edges, full_view_edges = read_only(edges.copy()), read_only(full_view_edges.copy())
        self.edges, self.oldest, self.most, self.modes = edges, len(uncontaminated), most, len(one_contaminated)
        self.tail, self.middle = tail, _normalised(benign_rows.mean(0) + contaminated_rows.mean(0))
        self._uncontaminated = [
            {kind: self._tailed(row, self.middle) for kind, row in of.items()} for of in uncontaminated
        ]
        self._one_contaminated = [
            {kind: self._tailed(row, self.middle) for kind, row in of.items()} for of in one_contaminated
        ]
        self._both_contaminated = [
            {kind: self._tailed(row, self.middle) for kind, row in of.items()} for of in both_contaminated
        ]
        self.full_view_edges, middle = full_view_edges, _stacked(full_view).mean(0)
        self._full_view = [{kind: self._tailed(row, middle) for kind, row in of.items()} for of in full_view]
        self._digest = self._digested()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Calibrated) and self._digest == other._digest

    def __hash__(self) -> int:
        return hash(self._digest)

    def _digested(self) -> str:
        """Digest of all densities: equal ones are known by it."""
        found = sha256(repr((self.oldest, self.most, self.modes, len(self.edges), self.tail)).encode())
        for array in (self.edges, self.full_view_edges, self.middle):
            found.update(array.tobytes())
        for densities in (self._uncontaminated, self._one_contaminated, self._both_contaminated, self._full_view):
            for of in densities:
                for _, row in sorted(of.items()):
                    found.update(row.tobytes())
        return found.hexdigest()

    def uncontaminated(self, size: int, reference: int, shared: int, age: int) -> Row:
        one, other = min(size, self.most), min(reference, self.most)
        common = round(shared * min(one, other) / min(size, reference))
        common = max(common, one + other - self.most)
        return self._uncontaminated[min(age, self.oldest) - 1][one, other, common]

    def one_contaminated(self, size: int, attackers: int, other: int, mode: int = 1) -> Row:
        other = min(other, self.most)
        if size <= self.most:
            return self._one_contaminated[mode - 1][size, attackers, other]
        diluted = attackers * self.most / size
        if diluted >= 1:
            return self.one_contaminated(self.most, round(diluted), other, mode)
        none = self.uncontaminated(self.most, other, other, 1)
        return diluted * self.one_contaminated(self.most, 1, other, mode) + (1 - diluted) * none

    def both_contaminated(self, size: int, other: int, mode: int = 1, other_mode: int = 1) -> Row:
        return self._both_contaminated[min(mode, other_mode) - 1][min(size, self.most), min(other, self.most)]

    def discrimination(self, age: int) -> float:
        return super().discrimination(age) * FADES ** max(age - self.oldest, 0)

    def full_view(self, size: int, attackers: int, everyone: int, total_attackers: int, mode: int = 1) -> Row:
        share, known = self.most / everyone, self._full_view[mode - 1]
        one = min(max(round(size * share), 1), self.most - 1)
        total = min(max(round(total_attackers * share), int(total_attackers > 0)), self.most - 1)
        if not attackers:
            return known[one, 0, min(total, self.most - one)]
        least, most = max(one + total - self.most, 1), min(one, total)
        return known[one, min(max(round(attackers * share), least), most), total]

    def utility(self, size: int, attackers: int, mode: int = 1) -> float:
        """Mean of the density. Beyond the measured sizes, what an uncontaminated view lacks shrinks as 1 / size."""
        middle = (self.edges[1:] + self.edges[:-1]) / 2
        if attackers:
            return float(self.one_contaminated(size, attackers, max(size, self.most), mode) @ middle)
        lack = 1 - float(self.uncontaminated(size, max(size, self.most), size, 1) @ middle)
        return 1 - lack * min(1.0, self.most / size)

    def _tailed(self, row: Row, middle: Row) -> Row:
        return _normalised((1 - self.tail) * row + self.tail * middle)


def _normalised(row: Row) -> Row:
    return read_only(row / row.sum())


def _stacked(densities: Sequence[Mapping[Any, Row]]) -> Float[np.ndarray, "R B"]:
    return np.array([row for of in densities for row in of.values()])


def open_likelihood(likelihood: str | Likelihood, fusion: str = DEFAULT) -> Likelihood:
    """Open the densities that a defender is built with.

    Args:
        likelihood: `"calibrated"`, the densities measured with the ego's detector; `"perfect"`, a binary verifier; the
            path of a calibration file; or a finished `Likelihood`.
        fusion: How the ego fuses, with the digest of its detector: see `calibration_for`.

    Raises:
        ValueError: For another name, or a calibration file that is broken.
    """
    if isinstance(likelihood, Likelihood):
        return likelihood
    if likelihood == "perfect":
        return Verifier()
    if likelihood == "calibrated" or likelihood.endswith(".json"):
        found = calibration_for(fusion, DENSITIES, None if likelihood == "calibrated" else Path(likelihood))
        return likelihood_of(found.densities(), str(found.path))
    raise ValueError(
        'likelihood must be "calibrated", "perfect", the path of a calibration file (.json) or a Likelihood, got '
        f"{likelihood!r}"
    )


def likelihood_of(stored: Mapping[str, Any], where: str = "this calibration") -> Calibrated:
    """The densities that `cp-calibrate` measured.

    Args:
        stored: The part of a calibration file.
        where: The name of the file, for messages.

    Raises:
        ValueError: If the part is broken. The message names the file.
    """
    try:
        n = int(stored["n_vehicles"])

        def by_kind(name: str, kinds: Sequence[Any]) -> list[dict[Any, Row]]:
            return [dict(zip(kinds, np.array(of, dtype=float), strict=True)) for of in stored[name]]

        return Calibrated(
            np.array(stored["edges"], dtype=float),
            by_kind("uncontaminated", overlaps(n)),
            by_kind("one_contaminated", attackers_in_one(n)),
            by_kind("both_contaminated", list(product(range(1, n + 1), repeat=2))),
            np.array(stored["full_view_edges"], dtype=float),
            by_kind("full_view", attackers_in_groups(n)),
            tail=float(stored["tail"]),
        )
    except (KeyError, IndexError, TypeError, AttributeError, ValueError) as error:
        raise ValueError(f"broken densities in {where}: {error!r}; measure them again with cp-calibrate") from error
