"""The programs behind Table 3 and Fig. 6: what they play, read and draw."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from cp_env.bank import SceneBank
from cp_env.detector import load_detector
from cp_env.intervals import Interval
from examples.reproduce import fusion_table, jaccard_histograms
from tests.toy import ToySource


@pytest.fixture(scope="module")
def bank(tmp_path_factory: pytest.TempPathFactory) -> SceneBank:
    """Three frames of a toy crossing."""
    root = tmp_path_factory.mktemp("bank")
    return SceneBank(ToySource(n_frames=3), load_detector("mean"), root=root, progress=False)


def test_fig_6_compares_consecutive_outputs(bank: SceneBank) -> None:
    args = jaccard_histograms.Args(frames=3, n_vehicles=3, n_attackers=2)
    found = {c: jaccard_histograms.play(bank, "mean", c, "toy-0", args) for c in ("upper bound", "lower bound", "BIM")}
    for values in found.values():
        assert all(len(row) == 2 and all(0 <= value <= 1 for value in row) for row in values.values())
    for honest in ("upper bound", "lower bound"):
        assert found[honest]["to_output"] == found[honest]["to_honest"]
    assert max(found["BIM"]["to_honest"]) < 0.5 < min(found["upper bound"]["to_honest"])
    assert jaccard_histograms.play(bank, "mean", "BIM", "toy-0", args) == found["BIM"]


def test_fig_6_goes_on_where_it_stopped(
    bank: SceneBank, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(jaccard_histograms, "KINDS", {"intersection": "k"})
    monkeypatch.setattr(jaccard_histograms, "open_source", lambda _: bank.source)
    monkeypatch.setattr(jaccard_histograms, "SceneBank", lambda *_, **__: bank)
    args = jaccard_histograms.Args(n_scenes=2, frames=2, fusions=("mean",), out=tmp_path)
    seen: list[str] = []

    def quick(_: Any, fusion: str, condition: str, name: str, __: Any) -> dict[str, list[float]]:
        if len(seen) == 7:
            raise KeyboardInterrupt
        seen.append(f"{fusion} {condition} {name}")
        return {"to_output": [0.5], "to_honest": [0.25]}

    monkeypatch.setattr(jaccard_histograms, "play", quick)
    with pytest.raises(KeyboardInterrupt):
        jaccard_histograms.main(args)
    seen.clear()
    jaccard_histograms.main(args)
    assert len(seen) == 3  # of ten
    data = json.loads((tmp_path / "jaccard.json").read_text())
    assert [len(row["scenes"]) for row in data["rows"]] == [2] * 5
    assert (tmp_path / "jaccard.png").stat().st_size > 10_000 and "0.50" in capsys.readouterr().out


def test_table_3_knows_its_rows_and_the_papers(tmp_path: Path) -> None:
    protocol = fusion_table.evaluation.Protocol(ToySource(n_frames=1), ("toy-0",))
    cells = fusion_table.plan(protocol, fusion_table.Args())
    played = {(cell.defender, cell.attack, cell.k) for cell in cells}
    assert played == {
        ("none", "none", 0),
        ("none", "pgd", 2),
        ("none", "bim", 2),
        ("none", "cw", 2),
        ("ego_only", "none", 0),
    }
    assert all(len(row) == len(fusion_table.FUSIONS) for row in fusion_table.PAPER.values())
    figures = {row: {fusion: Figures(row) for fusion in fusion_table.FUSIONS} for row in fusion_table.PAPER}
    assert {fusion_table.name_of(by["mean"]) for by in figures.values()} == set(fusion_table.PAPER)
    ours = [list(table.columns[5].cells) for table in fusion_table.screen(figures)]
    assert ours[0][0] == "81.0 [79, 83] | 80.5" and ours[1][0] == "61.0 [59, 63] | 76.7"
    assert fusion_table.draw(figures, tmp_path / "table.png").stat().st_size > 10_000


class Figures:
    """A row of figures."""

    def __init__(self, row: str) -> None:
        self.attack = "none" if row in ("upper", "lower") else row
        self.defender = "ego_only" if row == "lower" else "none"
        self.ap50 = Interval(0.81, 0.79, 0.83, 3)
        self.ap70 = replace(self.ap50, mean=0.61, low=0.59, high=0.63)
