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
from defenders import Prbi
from examples.reproduce import defence_figures, defence_pictures, defence_tables
from examples.reproduce.paper_tables import (
    ATTACKS,
    HEADLINE,
    PUBLISHED,
    TABLE_3,
    TABLE_6,
    TABLE_7,
    TABLE_LOSS,
    TABLES,
    Line,
    PaperTable,
)
from tests.helpers.toy_scenes import ToySource

ARGS = defence_tables.Args(n_scenes=2, frames=2, batch=1)
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
    runs = defence_tables.plan(CONDITIONS, [TABLE_3], ARGS)
    assert len(runs) == len(set(runs)) == 2 * (2 + 3 * 5)
    assert {run.k for run in runs if run.attack != "none"} == {2}
    games = [(run.names, run.attack) for run in runs]
    assert sum(a != b for a, b in itertools.pairwise(games)) == len(set(games)) - 1
    intermittent = {run.attack for run in defence_tables.plan(CONDITIONS, [TABLE_6], ARGS)}
    assert intermittent == {"pgd", "pgd:schedule=every@3:1", "pgd:schedule=every@5:1"}
    thresholds = {run.defender for run in defence_tables.plan(CONDITIONS, [TABLE_7], ARGS)}
    assert thresholds == {"prbi", *(f"prbi:epsilon={epsilon}" for epsilon in (0.3, 0.4, 0.45, 0.5))}
    assert Prbi().epsilon(frozenset({0})) == PUBLISHED
    together = defence_tables.plan(CONDITIONS, [TABLE_3, TABLE_LOSS, TABLE_6], ARGS)
    assert len(together) == len(set(together)) == len(runs) + 2 * (3 * 2 + 2)  # each new attack against none and PRBI
    (lock_step,) = {run.names for run in defence_tables.plan(CONDITIONS, [TABLE_6], replace(ARGS, batch=3))}
    assert lock_step == CONDITIONS.names


def test_the_headline_is_the_share_of_lost_ap_in_table_3() -> None:
    """79.4, 81.0 and 86.9 % with V2VNet: the mean of what comes back at AP@0.5 and at AP@0.7."""
    for attack, published in HEADLINE.items():
        assert defence_figures.papers_share(attack, "v2vnet") == pytest.approx(published, abs=0.06)


def test_an_unknown_table_is_refused() -> None:
    with pytest.raises(ValueError, match="no table '5': choose among 3, 6, 7, loss"):
        defence_tables.Args(table=("3", "5"))


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
    found = defence_figures.figures(Line("average", "prbi", ATTACKS), results)
    ap = found["ap50"]
    assert ap is not None and ap.mean == pytest.approx(2 / 3) and 0 < ap.low < ap.mean < ap.high < 1 and ap.n == 2
    alone = defence_figures.figures(Line("C&W", "prbi", ("cw",)), results)
    assert alone["ap50"] is not None and alone["ap50"].mean == 0
    for name, expected in (("id_rate", 0.5), ("mc_rate", 0.0), ("mc_runs", 0.0), ("frames_to_convergence", 5 / 3)):
        interval = found[name]
        assert interval is not None and interval.mean == pytest.approx(expected)


def test_runs_and_vehicles_are_different_units() -> None:
    """One of three benign vehicles flagged in one run of two: a sixth of the vehicles, half of the runs."""
    right = replace(record("toy-0", True), suspects=(1, 2))
    wrong = replace(record("toy-1", True), suspects=(1, 2, 3))
    results = {evaluation.Run("prbi", "pgd", 2, 0, (r.scene,)): (r,) for r in (right, wrong)}
    found = defence_figures.figures(Line("PGD", "prbi", ("pgd",)), results)
    vehicles, runs = found["mc_rate"], found["mc_runs"]
    assert vehicles is not None and runs is not None
    assert (vehicles.mean, runs.mean) == (pytest.approx(1 / 6), 0.5)
    assert (runs.low, runs.high) == pytest.approx((0.0126, 0.9874), abs=1e-4)  # the exact binomial bounds of 1 in 2


def test_what_is_regained_is_a_share_of_what_was_lost() -> None:
    """Of three vehicles none is found under attack, all without, and two with the defence, beside one ghost of the same
    score: AP is precision times recall there, 2/3 · 2/3."""
    hits = {("none", "none"): (True, True, True), ("none", "pgd"): (False,) * 3, ("prbi", "pgd"): (True, True, False)}
    results = {
        evaluation.Run(defender, attack, 2, 0, (f"toy-{i}",)): (record(f"toy-{i}", hit),)
        for (defender, attack), row in hits.items()
        for i, hit in enumerate(row)
    }
    share = defence_figures.regained(results, "prbi", "pgd")
    assert share.mean == pytest.approx(4 / 9) and share.low < share.mean < share.high and share.n == 3
    lines = list(defence_figures.headline({"v2vnet": results | {
        evaluation.Run(d, a, 2, 0, (f"toy-{i}",)): (record(f"toy-{i}", h),)
        for a in ("bim", "cw") for d in ("none", "prbi") for i, h in enumerate(hits[d, "pgd"])
    }}))  # fmt: skip
    assert [line.rpartition("\\| ")[2] for line in lines[1:]] == ["79.4 |", "81.0 |", "86.9 |"]


def test_the_ego_s_two_cases_are_told_apart() -> None:
    """Attackers 1 and 2 in one scene, 0 and 1 in the other, where nothing is found."""
    ego = replace(record("toy-1", False), attackers=(0, 1))
    results = {evaluation.Run("prbi", "pgd", 2, 0, (r.scene,)): (r,) for r in (record("toy-0", True), ego)}
    text = "\n".join(defence_figures.by_ego({"mean": results}, [Line("PGD", "prbi", ("pgd",))]))
    assert "the ego is benign: 1 scenes" in text and "| PGD | 100.0 [100.0, 100.0] |" in text
    assert "the ego is an attacker: 1 scenes" in text and "| PGD | 0.0 [0.0, 0.0] |" in text


def test_similarity_of_consecutive_outputs() -> None:
    """Frames 0 (benign), 1, 2 and 3: 0.1 to the benign frame before, then 0.3 on average."""
    of = {
        evaluation.Run("none", attack, 2, 0, (scene,)): (replace(record(scene, True), similarity=(1.0, 0.1, 0.2, 0.4)),)
        for attack in ("none", *ATTACKS)
        for scene in ("toy-0", "toy-1")
    }
    lines = list(defence_figures.fig_6({"v2vnet": of}))
    assert lines[1].startswith("| upper bound | 0.30 [") and lines[1].endswith("| around 0.8 |")
    assert lines[2].startswith("| PGD | 0.30 [") and lines[-1].startswith("| C&W, to the benign frame before | 0.10 [")


def test_objectives_are_paired_by_scene() -> None:
    """Two frames of 0 and d make a mean of d / 2: 0.2 and 0.3 with ours, 0.3 and 0.5 with the standard loss."""
    results = {
        evaluation.Run(defender, attack + option, 2, 0, (scene,)): (
            replace(record(scene, True), damage=(0.0, damage), similarity=(1.0, 2 * damage / 10), suspects=suspects),
        )
        for defender in ("none", "prbi")
        for attack in ATTACKS
        for option, damages, suspects in (("", (0.4, 0.6), (1, 2)), (":objective=detection_loss", (0.6, 1.0), (1,)))
        for scene, damage in zip(("toy-0", "toy-1"), damages, strict=True)
    }
    lines = list(defence_figures.objectives(results))
    assert len(lines) == 1 + 6
    cells = [cell.strip() for cell in lines[-1].split("|")[1:-1]]
    assert cells[0] == "C&W, prbi" and cells[1].startswith("0.250 [") and cells[2].startswith("0.400 [")
    assert cells[3].startswith("+0.150 [") and cells[4:] == ["0.10, 0.16", "100, 50"]


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
    monkeypatch.setitem(TABLES, "6", PaperTable(("mean",), figures, lines))
    args = defence_tables.Args(scenes=ToySource(n_frames=2), n_scenes=1, frames=2, table=("6",), out=tmp_path)  # type: ignore[arg-type]
    defence_tables.main(args)
    first = capsys.readouterr().out
    assert "\\| 50.0 |" in first and "| average, PRBI |" in first and "frames to convergence" in first
    data = json.loads((tmp_path / "table_6.json").read_text())
    assert [row["label"] for row in data["rows"]] == ["PGD, no defence", "average, PRBI"]
    assert (tmp_path / "table_6.png").stat().st_size > 10_000
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
