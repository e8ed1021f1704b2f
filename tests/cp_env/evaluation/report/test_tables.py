"""Tables: Markdown by hand, names that Markdown would take for its own, and pairwise results."""

from __future__ import annotations

import pytest

from cp_env.evaluation.analysis.comparisons import Difference
from cp_env.evaluation.analysis.measures import MEASURES
from cp_env.evaluation.analysis.strata import strata
from cp_env.evaluation.analysis.worst_case import rank_defenders
from cp_env.evaluation.plan.runs import Run
from cp_env.evaluation.report.tables import (
    Entry,
    Heading,
    Table,
    defender_ranking,
    difference_table,
    pairwise_results,
    strata_table,
)
from cp_env.metrics.intervals import Interval
from tests.helpers.toy_evaluation import record

SCORES = {
    "prbi": {"pgd": {"a": 0.2, "b": 0.4}, "noise": {"a": 0.0, "b": 0.1}},
    "none": {"pgd": {"a": 1.0}, "own": {"a": 0.5}},
}


def test_markdown_by_hand() -> None:
    table = Table([Heading("defender", number=False), Heading("AP")], [[Entry("prbi"), Entry("0.50", 0.5)]], "Below.")
    assert table.markdown() == "| defender | AP |\n|---|--:|\n| prbi | 0.50 |\n\nBelow.\n"


def test_names_stay_names_in_markdown() -> None:
    text = Table([Heading("name", number=False)], [[Entry("a|b*_c<d&")]]).markdown()
    assert text.splitlines()[-1] == r"| a\|b\*\_c&lt;d&amp; |"


def test_pairwise_results_are_means_over_scenes() -> None:
    table = pairwise_results(SCORES, lambda value: 1 - value, "Damage.")
    assert [heading.text for heading in table.headings] == ["defender", "pgd", "noise", "own"]
    prbi, none = table.rows
    assert [entry.text for entry in prbi] == ["prbi", "0.30", "0.05", "–"]
    assert [entry.text for entry in none] == ["none", "1.00", "–", "0.50"]
    assert prbi[1].value == pytest.approx(0.3) and prbi[1].shade == pytest.approx(0.7)
    assert prbi[3].value is None and prbi[3].shade is None, "what was not played is neither sorted nor shaded"


def test_a_ranking_prints_open_places_the_chance_of_being_first_and_measures_that_have_values() -> None:
    scenes = [f"s{i}" for i in range(8)]
    damage = {
        "good": {"loud": dict.fromkeys(scenes, 0.1)},
        "same": {"loud": {s: 0.05 * (i % 4) + 0.03 for i, s in enumerate(scenes)}},
        "bad": {"loud": dict.fromkeys(scenes, 0.9)},
    }
    empty = {name: {"loud": {}} for name in damage}
    table = defender_ranking(rank_defenders({"damage": damage, "critical_recall": empty}), [])
    assert [heading.text for heading in table.headings][:5] == [
        "rank",
        "first",
        "defender",
        "detection loss/frame, worst attack",
        "worst attack (scenes)",
    ]
    rows = {row[2].text: [row[0].text, row[0].value, row[1].text] for row in table.rows}
    assert rows["bad"] == ["3", 3, "0.00"] and rows["good"][0] == rows["same"][0] == "1–2"


def test_differences_name_the_better_entry_first() -> None:
    pairs = [
        Difference("a", "b", Interval(0.4, 0.3, 0.5, 21), 0.0001, 0.0002),
        Difference("a", "c", Interval(-0.1, -0.3, 0.1, 21), 0.3, 0.6),
    ]
    lower, higher = (difference_table(pairs, MEASURES[name]) for name in ("damage", "ap50"))
    assert [[entry.text for entry in row] for row in lower.rows] == [
        ["b", "a", "-0.400 [-0.500, -0.300]", "< 0.001", "yes"],
        ["a", "c", "-0.100 [-0.300, 0.100]", "0.600", "no"],
    ]
    assert [entry.text for entry in higher.rows[0]] == ["a", "b", "0.400 [0.300, 0.500]", "< 0.001", "yes"]


def test_where_the_ego_attacks_is_a_column_of_its_own() -> None:
    episodes = [record("a", "10", 2, attackers=(0, 2)), record("b", "11", 2), record("c", "11", 2)]
    table = strata_table(strata({Run("prbi", "pgd", 2, 0, ("a", "b", "c")): episodes}, resamples=10))
    assert [heading.text for heading in table.headings][2:] == [
        "episodes, ego benign",
        "AP@.5, ego benign",
        "detection loss/frame, ego benign",
        "episodes, ego an attacker",
        "AP@.5, ego an attacker",
        "detection loss/frame, ego an attacker",
    ]
    (row,) = table.rows
    assert [entry.text for entry in row][:3] == ["prbi", "pgd", "2"] and row[5].text == "1"
    assert row[3].value == 1.0 and row[6].text == "0.500 (n=1)"
