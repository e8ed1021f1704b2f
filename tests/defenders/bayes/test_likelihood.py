"""How probable a similarity is: every density a density, rows by hand, what is extrapolated, and broken files."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from defenders.bayes.histograms import Calibrated, open_likelihood
from defenders.bayes.likelihood import OUTLIER_MIX, FullViewTable, Likelihood, Table, attackers_in_groups
from tests.helpers.densities import made_up


@pytest.mark.parametrize("likelihood", ["perfect", "calibrated", made_up(1)], ids=["perfect", "calibrated", "wild"])
@pytest.mark.parametrize("n", [1, 2, 5, 9, 20])
def test_every_density_is_one_and_bounded(likelihood: str | Likelihood, n: int) -> None:
    likelihood = open_likelihood(likelihood)
    for table in likelihood.tables(n):
        assert table.density.sum(1) == pytest.approx(1)
        assert (table.density > 0).all()
    if isinstance(likelihood, Calibrated):
        density = np.concatenate([table.density for table in likelihood.tables(n)])
        ratio = density.max(0) / density.min(0)
        assert (ratio <= density.max(0) / (likelihood.tail * likelihood.middle) * 1.001).all()


def test_rows_of_a_table_by_hand() -> None:
    likelihood = made_up(3)
    table = Table(likelihood, 4, 2)

    def density(size: int, attackers: int, reference: int, its: int, a: int = 0, b: int = 0) -> np.ndarray:
        return table.density[table.rows(size, reference, 1)[a, attackers, b, its]]

    assert (density(2, 0, 3, 0) == likelihood.uncontaminated(2, 3, 1, 2)).all()
    assert (density(2, 0, 3, 0, 1, 2) == likelihood.uncontaminated(2, 3, 1, 2)).all()
    assert (density(3, 2, 1, 0, 2, 0) == likelihood.one_contaminated(3, 2, 1, 2)).all()
    assert (density(3, 2, 4, 0, 1, 2) == likelihood.one_contaminated(3, 2, 3, 1)).all()
    assert (density(3, 0, 2, 1, 1, 2) == likelihood.one_contaminated(2, 1, 3, 2)).all()
    assert (density(3, 2, 2, 1, 2, 2) == likelihood.both_contaminated(3, 2, 2, 2)).all()
    assert (density(4, 2, 2, 1, 1, 2) == likelihood.both_contaminated(3, 2, 1, 1)).all()
    assert (density(3, -1, 2, -1, 2, 1) == likelihood.outlier(3, 2, 2)).all()
    assert (density(4, 0, 2, -1, 0, 1) == likelihood.outlier(3, 2, 1)).all()
    assert (density(3, 2, 2, -1) == likelihood.uncontaminated(3, 2, 1, 2)).all()  # no attack, whatever the numbers
    assert (density(3, -1, 2, 1, 0, 2) == likelihood.one_contaminated(2, 1, 3, 2)).all()


def test_rows_of_the_full_view_by_hand() -> None:
    likelihood = made_up(3)
    table = FullViewTable(likelihood, 3)

    def density(size: int, attackers: int, total: int, mode: int = 1) -> np.ndarray:
        return table.density[int(table.rows(size, np.array(attackers), np.array(total), mode))]

    assert (density(2, 1, 2, 2) == likelihood.full_view(2, 1, 3, 2, 2)).all()
    assert (density(1, 0, 0) == likelihood.full_view(1, 0, 3, 0)).all()
    kinds = [(attackers, total) for size, attackers, total in attackers_in_groups(3) if size == 1]
    kinds = [*kinds, (1, 3)]  # among them all vehicles attacking, which never happens
    contaminated = np.mean([likelihood.full_view(1, d, 3, k, 2) for d, k in kinds], axis=0)
    outlier = (1 - OUTLIER_MIX) * likelihood.full_view(1, 0, 3, 0, 2) + OUTLIER_MIX * contaminated
    assert density(1, -1, -1, 2) == pytest.approx(outlier)


@given(st.integers(2, 40), st.data())
def test_full_views_of_any_size_separate_contaminated_groups_from_others(n: int, data: st.DataObject) -> None:
    """Sizes that were not measured: in proportion, but no attacker where there is none, and one where there is."""
    likelihood = made_up(0, most=5)
    size = data.draw(st.integers(1, n - 1))
    total = data.draw(st.integers(0, n - 1))
    attackers = data.draw(st.integers(max(size + total - n, 0), min(size, total)))
    row = likelihood.full_view(size, attackers, n, total)
    same_kind = [
        likelihood.full_view(s, d, 5, k)
        for s, d, k in attackers_in_groups(5)
        if bool(d) == bool(attackers) and bool(k) == bool(total)
    ]
    assert any((row == other).all() for other in same_kind)
