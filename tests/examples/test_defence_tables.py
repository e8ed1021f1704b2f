"""Tables 3, 6 and 7: the paper's figures as transcribed, what is played for ours, and how they are set side by side."""

from __future__ import annotations

import itertools
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cp_env import evaluation
from cp_env.evaluation.execution import runner
from cp_env.evaluation.plan.records import IOUS
from cp_env.metrics.average_precision import ApMeter
from cp_env.types import Detections
from examples.reproduce import defence_pictures, defence_tables
from examples.reproduce.paper_tables import ATTACKS, TABLE_3, TABLE_6, TABLE_7, TABLES, Line, PaperTable
from tests.helpers.toy_scenes import ToySource

ARGS = defence_tables.Args(n_scenes=2, frames=2)
CONDITIONS = evaluation.Conditions(ToySource(n_frames=2), ("toy-0", "toy-1"), 2)


def line(table: PaperTable, label: str) -> Line:
    (found,) = (one for one in table.lines if one.label == label)
    return found


@pytest.mark.parametrize("table", TABLES.values(), ids=TABLES)
def test_every_line_has_a_figure_for_every_fusion(table: PaperTable) -> None:
    assert len({one.label for one in table.lines}) == len(table.lines)
    for one in table.lines:
        assert set(one.paper) in (set(), set(table.figures))
        assert all(len(row) == len(table.fusions) for row in one.paper.values())


@pytest.mark.parametrize("figure", ["ap50", "ap70"])
def test_the_papers_averages_are_those_of_its_rows(figure: str) -> None:
    """So PRBI's last row is the average over the attacks, and Table 7 plays DiscoNet against all three."""
    rows = [line(TABLE_3, f"{name}, PRBI").paper[figure] for name in ("PGD", "BIM", "C&W")]
    average = line(TABLE_3, "average, PRBI").paper[figure]
    np.testing.assert_allclose(np.mean(rows, axis=0), average, atol=0.0051)
    assert line(TABLE_7, "ε = 0.35").paper[figure] == average[-1:]


def test_every_cell_is_played_once_and_attacks_in_a_row() -> None:
    runs = defence_tables.plan(CONDITIONS, TABLE_3, ARGS)
    assert len(runs) == len(set(runs)) == 2 * (2 + 3 * 7)
    assert {run.k for run in runs if run.attack != "none"} == {2}
    games = [(run.names, run.attack) for run in runs]
    assert sum(a != b for a, b in itertools.pairwise(games)) == len(set(games)) - 1
    intermittent = {run.attack for run in defence_tables.plan(CONDITIONS, TABLE_6, ARGS)}
    assert intermittent == {"pgd", "pgd:schedule=every@3:1", "pgd:schedule=every@5:1"}
    thresholds = {run.defender for run in defence_tables.plan(CONDITIONS, TABLE_7, ARGS)}
    assert thresholds == {f"prbi:epsilon={epsilon}" for epsilon in (0.3, 0.35, 0.4, 0.45, 0.5)}


def test_one_attacker_serves_all_cells() -> None:
    assert defence_tables.make_attack("pgd", steps=3) is defence_tables.make_attack("pgd", steps=3)
    assert defence_tables.make_attack("pgd", steps=3) is not defence_tables.make_attack("pgd", steps=4)


def record(scene: str, hit: bool, converged: int | None = None) -> evaluation.Record:
    """One frame with one vehicle, which is found or not."""
    box = np.array([[0.0, 0.0, 4.0, 2.0, 0.0]], dtype=np.float32)
    meter = ApMeter(IOUS)
    meter.add(Detections(box if hit else box + 10, np.array([0.9], dtype=np.float32)), box)
    return evaluation.Record(
        scene=scene,
        attackers=(1, 2),
        n_maps=5,
        grace_frames=1,
        meter=meter,
        damage=(0.0, 0.5),
        similarity=(1.0, 0.5),
        verifications=(0, 2),
        suspects=(1,),
        converged=converged,
        error=None,
        seconds=1.0,
    )


def test_figures_are_averages_over_attacks() -> None:
    hits = {"pgd": True, "bim": True, "cw": False}
    results = {
        evaluation.Run(defender, attack, 2, 0, (scene,)): (record(scene, hits[attack], 3 if attack == "cw" else 1),)
        for defender in ("prbi", "none")
        for attack in ATTACKS
        for scene in ("toy-0", "toy-1")
    }
    found = defence_tables.figures(Line("average", "prbi", ATTACKS), results)
    ap = found["ap50"]
    assert ap is not None and ap.mean == pytest.approx(2 / 3) and 0 < ap.low < ap.mean < ap.high < 1 and ap.n == 2
    alone = defence_tables.figures(Line("C&W", "prbi", ("cw",)), results)
    assert alone["ap50"] is not None and alone["ap50"].mean == 0
    for name, expected in (("id_rate", 0.5), ("mc_rate", 0.0), ("frames_to_convergence", 5 / 3)):
        interval = found[name]
        assert interval is not None and interval.mean == pytest.approx(expected)


def test_averages_need_the_same_scenes() -> None:
    with pytest.raises(ValueError, match="the same scenes in each"):
        evaluation.mean_ap([[record("toy-0", True)], [record("toy-1", True)]], 0.5)


def test_a_table_is_played_printed_and_drawn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """From nothing, and from what is kept."""
    lines = (
        Line("PGD, no defence", "none", ("pgd:steps=1",), {"ap50": (50.0,), "ap70": (40.0,)}),
        Line("average, PRBI", "prbi", ("pgd:steps=1", "bim:steps=1")),
    )
    figures = ("ap50", "ap70", "frames_to_convergence")
    monkeypatch.setitem(TABLES, 3, PaperTable(("mean",), figures, lines))
    args = defence_tables.Args(scenes=ToySource(n_frames=2), n_scenes=1, frames=2, out=tmp_path)  # type: ignore[arg-type]
    defence_tables.main(args)
    first = capsys.readouterr().out
    assert "\\| 50.0 |" in first and "| average, PRBI |" in first and "frames to convergence" in first
    data = json.loads((tmp_path / "table_3.json").read_text())
    assert [row["label"] for row in data["rows"]] == ["PGD, no defence", "average, PRBI"]
    assert (tmp_path / "table_3.png").stat().st_size > 10_000
    monkeypatch.setattr(runner, "play", lambda *_: pytest.fail("played again"))
    defence_tables.main(args)
    assert capsys.readouterr().out == first


def test_fig_2_shows_what_the_ego_acts_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = ToySource(n_frames=2)
    args = defence_pictures.Args(
        scenes=source,  # type: ignore[arg-type]
        scene="toy-0",
        frame=1,
        fusions=("mean",),
        attack="bim:steps=2",
        defenders=("none", "ego_only"),
        out=tmp_path,
    )
    defence_pictures.main(args)
    data = json.loads((tmp_path / "defence_pictures.json").read_text())
    benign, attacked, alone = data["panels"]
    assert [panel["condition"] for panel in data["panels"]] == ["no attack", "BIM, no defence", "BIM, ego_only"]
    assert benign["attackers"] == [] and len(attacked["attackers"]) == 2
    assert (attacked["fused"], alone["fused"]) == ([0, 1, 2, 3, 4], [0])
    assert benign["truth"] == attacked["truth"] == alone["truth"] and benign["seen"] != attacked["seen"]
    assert len(benign["seen"]) == benign["ghosts"] + len(benign["truth"]) - benign["missed"]
    assert (tmp_path / "defence_pictures.png").stat().st_size > 30_000
    monkeypatch.setattr(defence_pictures, "play", lambda *_: pytest.fail("played again"))
    defence_pictures.main(args)
    with pytest.raises(ValueError, match=r"no scene 'toy-9'; known: toy-0, toy-1"):
        defence_pictures.main(replace(args, scene="toy-9"))
