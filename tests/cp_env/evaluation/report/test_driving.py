"""The driving table as text."""

from __future__ import annotations

from cp_env.evaluation import Run, summarise
from cp_env.evaluation.report.driving import COLUMNS, driving_cells, driving_markdown
from cp_env.evaluation.report.tables import driving_table
from tests.cp_env.evaluation.analysis.test_driving import DRIVEN, episode

(ROW,) = summarise({Run("prbi", "pgd", 2, 0, ("a",)): [episode("a", DRIVEN)]}, resamples=10)
(BARE,) = summarise({Run("prbi", "pgd", 2, 0, ("a",)): [episode("a", None)]}, resamples=10)


def test_every_column_has_a_cell_and_what_is_not_known_a_dash() -> None:
    assert ROW.driving is not None
    cells = dict(zip([heading for heading, *_ in COLUMNS], driving_cells(ROW.driving), strict=True))
    assert cells["MDR"] == ("2.50 (n=1)", 2.5)
    assert cells["critical AP@.5"] == ("–", None)
    assert cells["ms/frame"] == ("166.7", 1000 * 0.5 / 3)


def test_the_markdown_holds_the_rows_and_what_the_columns_are() -> None:
    text = driving_markdown([ROW, BARE])
    lines = [line for line in text.splitlines() if line.startswith("| prbi")]
    assert len(lines) == 1 and lines[0].count("|") == len(COLUMNS) + 4
    assert all(heading.split(" ")[0] in text.split("| prbi")[1] for heading, *_ in COLUMNS)
    assert driving_markdown([BARE]) == ""


def test_the_table_of_the_arena_has_the_same_cells() -> None:
    table = driving_table([ROW, BARE])
    assert len(table.rows) == 1
    assert ROW.driving is not None
    assert [(entry.text, entry.value) for entry in table.rows[0][3:]] == driving_cells(ROW.driving)
