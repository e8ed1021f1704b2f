"""Table 2: played, and worked out."""

from __future__ import annotations

import itertools
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from defenders import Pasac
from defenders.simulation.world import SimulatedWorld
from examples.reproduce import verification_counts
from tests.defenders.test_robosac import Ordered


@pytest.mark.slow
def test_table_2_over_20000_episodes(tmp_path: Path) -> None:
    """In a process without shape checks, as the program is run: means to 2 %, minima and PASAC's maxima exactly."""
    program = Path(verification_counts.__file__)
    rows = ("ROBOSAC", "PASAC")
    subprocess.run(
        [sys.executable, program, "--rows", *rows, "--out", tmp_path],
        check=True,
        capture_output=True,
        env={**os.environ, "PYTHONPATH": str(program.parents[2])},
    )
    found = {(row["defender"], row["k"]): row for row in json.loads((tmp_path / "perfect.json").read_text())["rows"]}
    expected = ((1, 5, 4.8, 4, 6), (2, 10, 6.6, 4, 8), (3, 10, 7.6, 6, 8), (4, 5, 8, 8, 8))
    for k, tries, halvings, least, most in expected:
        robosac, pasac = (found[row, k] for row in rows)
        assert robosac["frames"] == pasac["frames"] == 20_000
        assert robosac["mean"] == pytest.approx(tries, rel=0.02) and robosac["least"] == 1
        assert pasac["mean"] == pytest.approx(halvings, rel=0.02)
        assert (pasac["least"], pasac["most"]) == (least, most)


def test_table_2_worked_out_is_what_is_played() -> None:
    """The column "exact" of the program against the defenders, beyond five collaborators."""
    for n, k in ((4, 2), (7, 1), (7, 3)):
        counts = []
        for attackers in map(frozenset, itertools.combinations(range(1, n + 1), k)):
            defender, world = Pasac(score="similarity"), SimulatedWorld(n + 1, attackers)
            defender.reset(n + 1, Ordered(list(range(1, n + 1))))
            counts.append(world.judge(defender).verifications)
        assert np.mean(counts) == pytest.approx(verification_counts.exact("PASAC", n, k))
    assert [verification_counts.exact("ROBOSAC", 5, k) for k in (1, 2, 3, 4)] == [5, 10, 10, 5]
