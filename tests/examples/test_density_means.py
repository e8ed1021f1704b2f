"""The mean similarities of the densities that ship: a histogram by hand, and what every fusion's tables hold."""

from __future__ import annotations

from typing import get_args

import pytest

from cp_env.settings import Fusion
from examples.reproduce import density_means


def test_the_mean_of_a_histogram_is_that_of_its_middles() -> None:
    """0.25 · 0.2 + 0.75 · 0.7 = 0.575."""
    assert density_means.means([[0.25, 0.75]], [0, 0.4, 1], [(1, 0, 5)]) == {(1, 0, 5): pytest.approx(0.575)}


@pytest.mark.parametrize("fusion", get_args(Fusion))
def test_every_fusion_has_both_tables(fusion: Fusion, capsys: pytest.CaptureFixture[str]) -> None:
    """A title, five sizes before and four in the same frame; an attacker more than members is a dash."""
    density_means.main(density_means.Args(fusion))
    shown = capsys.readouterr().out
    rows = [line for line in shown.splitlines() if line.startswith("│ ")]
    assert [row.split("│")[1].strip() for row in rows] == [*"12345", *"1234", *"1234"]
    assert rows[0].split("│")[4].strip() == "–" and rows[1].split("│")[4].strip() != "–"
