"""Episodes in which the ego is, and is not, an attacker."""

from __future__ import annotations

import pytest

from cp_env.evaluation.analysis.strata import strata
from cp_env.evaluation.analysis.summary import summarise
from cp_env.evaluation.plan.records import Record
from cp_env.evaluation.plan.runs import Run
from tests.helpers.toy_evaluation import record

LOST = {"damage": (0.0, 1.0, 1.0), "attackers": (0, 3)}
KEPT = {"damage": (0.0, 0.1, 0.1), "attackers": (1, 3)}


def results() -> dict[Run, list[Record]]:
    """A defender that loses everything where the ego attacks, and little where it does not: two episodes a scene."""
    clean = [record(s, "1111", 4, attackers=()) for s in "ab"]
    return {
        Run("none", "none", 0, 0, ("a", "b")): clean,
        Run("none", "pgd", 2, 0, ("a", "b")): [record("a", "10", 4, **LOST), record("b", "10", 4, **KEPT)],
        Run("wall", "pgd", 2, 0, ("a", "b")): [record("a", "10", 4, **LOST), record("b", "111", 4, **KEPT)],
        Run("wall", "pgd", 2, 1, ("a", "b")): [record("a", "111", 4, **KEPT), record("b", "111", 4, **KEPT)],
    }


def test_each_episode_is_in_one_part_and_unattacked_ones_are_in_none() -> None:
    benign, attacker = strata(results(), resamples=20)
    assert (benign.name, attacker.name) == ("ego_benign", "ego_attacker")
    whole = {row.defender: row for row in summarise(results(), resamples=20) if row.attack == "pgd"}
    for defender, row in whole.items():
        parts = [part for stratum in (benign, attacker) for part in stratum.rows if part.defender == defender]
        assert sum(part.n_episodes for part in parts) == row.n_episodes
    assert {row.attack for stratum in (benign, attacker) for row in stratum.rows} == {"pgd"}


def test_what_the_whole_hides_shows_in_the_parts() -> None:
    benign, attacker = ({row.defender: row for row in stratum.rows} for stratum in strata(results(), resamples=20))
    assert benign["wall"].damage.mean == pytest.approx(0.2 / 3)
    assert attacker["wall"].damage.mean == pytest.approx(2 / 3)
    assert attacker["wall"].n_scenes == 1 and benign["wall"].n_scenes == 2
    assert benign["wall"].recovery50 is None, "there `none` has not played both scenes"
    assert attacker["wall"].recovery50 is not None and attacker["wall"].recovery50.mean == pytest.approx(0.0)


def test_one_case_alone_is_no_table() -> None:
    same = {run: of for run, of in results().items() if run.seed == 1 or run.attack == "none"}
    assert strata(same, resamples=20) == []
    assert strata({}, resamples=20) == []
