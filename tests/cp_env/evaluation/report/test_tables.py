"""Tables: Markdown by hand, names that Markdown would take for its own, and pairwise results."""

from __future__ import annotations

import pytest

from cp_env.evaluation.report.tables import Entry, Heading, Table, pairwise_results

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
