"""How probable a similarity is: every density a density, rows by hand, what is extrapolated, and broken files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from defenders.bayes.histograms import CALIBRATED, Calibrated, open_likelihood, read_likelihood
from defenders.bayes.likelihood import ODD, BesideTable, Likelihood, Table, Verifier, liars_in_groups
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


@pytest.mark.parametrize("fusion", [path.stem for path in sorted(CALIBRATED.glob("*.json"))])
def test_more_liars_or_older_references_never_look_better_on_average(fusion: str) -> None:
    """The shipped densities, measured or not."""
    likelihood = open_likelihood("calibrated", fusion)
    middle = (likelihood.edges[1:] + likelihood.edges[:-1]) / 2
    for size in (1, 2, 3, 5, 8, 12, 20):
        clean = [
            float(likelihood.clean(size, max(size, 5), size, age) @ middle) for age in range(1, likelihood.oldest + 1)
        ]
        assert clean == sorted(clean, reverse=True)
        for manner in range(1, likelihood.manners + 1):
            one, all_lie = (likelihood.dirty(size, liars, 5, manner) @ middle for liars in (1, size))
            assert all_lie <= one + 0.05 and one < clean[0]
            assert 0 <= likelihood.worth(size, 1, manner) < likelihood.worth(size, 0) <= 1


def test_rows_of_a_table_by_hand() -> None:
    likelihood = made_up(3)
    table = Table(likelihood, 4, 2)

    def density(size: int, liars: int, reference: int, its: int, a: int = 0, b: int = 0) -> np.ndarray:
        return table.density[int(table.rows(size, np.array(liars), reference, np.array(its), 1, a, b))]

    assert (density(2, 0, 3, 0) == likelihood.clean(2, 3, 1, 2)).all()
    assert (density(2, 0, 3, 0, 1, 2) == likelihood.clean(2, 3, 1, 2)).all()
    assert (density(3, 2, 1, 0, 2, 0) == likelihood.dirty(3, 2, 1, 2)).all()
    assert (density(3, 2, 4, 0, 1, 2) == likelihood.dirty(3, 2, 3, 1)).all()
    assert (density(3, 0, 2, 1, 1, 2) == likelihood.dirty(2, 1, 3, 2)).all()
    assert (density(3, 2, 2, 1, 2, 2) == likelihood.both(3, 2, 2, 2)).all()
    assert (density(4, 2, 2, 1, 1, 2) == likelihood.both(3, 2, 1, 1)).all()
    assert (density(3, -1, 2, -1, 2, 1) == likelihood.glitch(3, 2, 2)).all()
    assert (density(4, 0, 2, -1, 0, 1) == likelihood.glitch(3, 2, 1)).all()


def test_rows_beside_the_free_view_by_hand() -> None:
    likelihood = made_up(3)
    table = BesideTable(likelihood, 3)

    def density(size: int, liars: int, lying: int, manner: int = 1) -> np.ndarray:
        return table.density[int(table.rows(size, np.array(liars), np.array(lying), manner))]

    assert (density(2, 1, 2, 2) == likelihood.beside(2, 1, 3, 2, 2)).all()
    assert (density(1, 0, 0) == likelihood.beside(1, 0, 3, 0)).all()
    kinds = [(liars, lying) for size, liars, lying in liars_in_groups(3) if size == 1]
    kinds = [*kinds, (1, 3)]  # with everyone lying, which is never, among them
    of_lies = np.mean([likelihood.beside(1, d, 3, k, 2) for d, k in kinds], axis=0)
    glitch = (1 - ODD) * likelihood.beside(1, 0, 3, 0, 2) + ODD * of_lies
    assert density(1, -1, -1, 2) == pytest.approx(glitch)


@given(st.integers(2, 40), st.data())
def test_beside_a_free_view_of_any_size_who_lies_is_told_from_who_does_not(n: int, data: st.DataObject) -> None:
    """Sizes that were not measured: in proportion, but no liar where there is none, and one where there is."""
    likelihood = made_up(0, most=5)
    size = data.draw(st.integers(1, n - 1))
    lying = data.draw(st.integers(0, n - 1))
    liars = data.draw(st.integers(max(size + lying - n, 0), min(size, lying)))
    row = likelihood.beside(size, liars, n, lying)
    alike = [
        likelihood.beside(s, d, 5, k)
        for s, d, k in liars_in_groups(5)
        if bool(d) == bool(liars) and bool(k) == bool(lying)
    ]
    assert any((row == other).all() for other in alike)


def test_bins() -> None:
    likelihood = Verifier()
    assert [likelihood.bin(s) for s in (-0.1, 0.0, 0.49, 0.5, 1.0, 1.1)] == [0, 0, 0, 1, 1, 1]


def test_likelihood_doors(tmp_path: Path) -> None:
    assert isinstance(open_likelihood("perfect"), Verifier)
    with pytest.raises(ValueError, match="likelihood must be"):
        open_likelihood("perhaps")
    with pytest.raises(ValueError, match="false_pass"):
        Verifier(false_pass=0.5)
    with pytest.raises(ValueError, match="no calibrated likelihood"):
        read_likelihood(tmp_path / "nowhere.json")
    good = json.loads((CALIBRATED / "mean.json").read_text())
    path = tmp_path / "likelihood.json"
    breaks = {"edges": [0, 0.5], "tail": 2, "both": [[1.0]], "dirty": good["dirty"][:1], "clean": [], "beside": []}
    for name, value in breaks.items():
        path.write_text(json.dumps({**good, name: value}))
        with pytest.raises(ValueError, match=path.name):
            read_likelihood(path)
