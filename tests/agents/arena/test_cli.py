"""The command line: your own classes enter, errors name what is known, a killed arena goes on, the records suffice."""

from __future__ import annotations

import functools
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from agents.arena import cli, make_attack
from agents.arena.cli import main
from agents.protocol import Learned
from cp_env.evaluation import Record, Run, summarise
from cp_env.evaluation.analysis.worst_case import damage_per_frame, extremes, mean_interval
from cp_env.evaluation.plan.runs import Conditions, code_of
from tests.helpers.toy_arena import install
from tests.helpers.toy_evaluation import contents

ROOT = Path(__file__).parents[3]
MINE = """
from agents.attacks.noise import NoPerturbation
from defenders import Defender, Query, Verdict


class Halves(Defender):
    def __init__(self, first=2):
        self.first = first

    def reset(self, n_vehicles, rng):
        self.n = n_vehicles

    def inspect(self, frame):
        yield Query([range(self.first), range(self.first, self.n)])
        return Verdict(range(self.first))


class Shout(NoPerturbation):
    def __init__(self, level=1.0):
        self.level = level

    def act(self, situation):
        return super().act(situation) + self.level * situation.budget
"""
ENTRIES = (
    "--defenders",
    "none",
    "mine_too:Halves:first=3",
    "oracle",
    "--attacks",
    "pgd:steps=1",
    "mine_too:Shout:level=0.5",
)
SMALL = ("--scenes", "toy:any", "--frames", "3", "--batch", "1", "--seeds", "7", "8", "--workers", "1")


@pytest.fixture(scope="module", autouse=True)
def toys() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        install(patch.setitem, patch.setattr)
        patch.setattr(cli, "collect_results", functools.partial(cli.collect_results, resamples=20))
        yield


@pytest.fixture
def custom_classes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with `mine_too.py` in it, which is where we are."""
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.delitem(sys.modules, "mine_too", raising=False)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine_too.py").write_text(MINE)
    code_of.cache_clear()
    return tmp_path


def test_own_classes_enter_by_module_and_name(custom_classes: Path, capsys: pytest.CaptureFixture[str]) -> None:
    axes = (
        "--ks",
        "2",
        "1",
        "--budgets",
        "0.3",
        "0.1",
        "--off-baseline-attacks",
        "pgd:steps=1",
        "--off-baseline-scenes",
        "1",
    )
    main([*SMALL, *ENTRIES, *axes, "--page", "pages/leaders.md", "--grace-frames", "0"])
    out = custom_classes / "out" / "arena"
    data = json.loads((out / "arena.json").read_text())
    assert {line["entry"]: line["rank"] is None for line in data["defenders"]} == {
        "none": False,
        "mine_too:Halves:first=3": False,
        "oracle": True,
    }
    assert {line["entry"] for line in data["attacks"]} == {"pgd:steps=1", "mine_too:Shout:level=0.5"}
    assert [(curve["axis"], curve["values"], curve["n_scenes"]) for curve in data["curves"]] == [
        ("k", [1, 2], 1),
        ("budget", [0.1, 0.3], 1),
    ]
    halves = [row for row in data["rows"] if row["defender"].startswith("mine_too")]
    assert halves and all(row["verifications"]["mean"] == 2 for row in halves)
    assert data["about"]["conditions"]["grace_frames"] == 0 and data["about"]["seeds"] == [7, 8]
    assert data["about"]["command"].startswith("cp-arena --scenes toy:any")
    entries = [json.loads(file.read_text()) for file in (out / "entries").iterdir()]
    assert {(entry["role"], entry["entry"]) for entry in entries} == {
        *(("defender", line["entry"]) for line in data["defenders"]),
        *(("attack", line["entry"]) for line in data["attacks"]),
    }
    videos = {entry["worst_episode"]["gif"] for entry in entries if entry["role"] == "defender"}
    assert videos == {video.name for video in (out / "videos").iterdir()}
    pictures = {file.name for file in (custom_classes / "pages" / "leaders").iterdir()}
    page = (custom_classes / "pages" / "leaders.md").read_text()
    assert pictures == {
        "defenders.svg",
        "attacks.svg",
        "trade-off.svg",
        "curve-k.svg",
        "curve-budget.svg",
        "worst.gif",
    }
    assert all(f"(leaders/{name})" in page for name in pictures) and "cp-arena --scenes toy:any" in page
    assert "arena.html" in capsys.readouterr().out


def test_a_changed_class_is_played_anew(custom_classes: Path) -> None:
    conditions = Conditions("toy:any", ("toy-0",))
    runs = [Run("mine_too:Halves", "none", 0, 0, ("toy-0",)), Run("prbi", "none", 0, 0, ("toy-0",))]
    sys.path.insert(0, str(custom_classes))
    before = [run.slug(conditions) for run in runs]
    assert before == [run.slug(conditions) for run in runs]
    (custom_classes / "mine_too.py").write_text(MINE.replace("first=2", "first=1"))
    code_of.cache_clear()
    mine, ours = [run.slug(conditions) for run in runs]
    assert mine != before[0] and ours == before[1]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--defenders", "prbbi"], "unknown defender 'prbbi' .did you mean 'prbi'.*; known: prbi, .*none"),
        (["--defenders", "nowhere:Halves"], "no defender 'nowhere:Halves'"),
        (
            ["--attacks", "pdg"],
            "unknown attack 'pdg' .did you mean 'pgd'.*; known: none, noise, .*pgd, .*policy; or module:Class",
        ),
        (["--attacks", "policy:name=prbi-99"], "unknown policy 'prbi-99'; known: .*prbi-0"),
        (
            ["--attacks", "tests.helpers.toy_evaluation:ToySource"],
            "is no attack: it must be a class with the methods reset, act or options, __call__.*nothing was called",
        ),
        (["--attacks", "pgd:wisdom=1"], "wisdom"),
        (["--design", "round"], "unknown design 'round'.*one-factor-at-a-time, full"),
        (["--n-scenes", "3"], "n_scenes must be 1 to 2, not 3"),
        (["--ks", "5"], "0 <= k < n"),
        (["--rank-by", "damge"], "unknown measure 'damge' .did you mean 'damage'.*: choose one of damage, ap50"),
        (["--screen", "toy:any"], "screened on other scenes than those reported on; both hold toy-0, toy-1"),
        (["--screen", "elsewhere:any", "--screen-scenes", "3"], "n_scenes must be 1 to 2, not 3"),
    ],
)
def test_bad_input_is_named_in_one_line(words: list[str], message: str, tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match=f"cp-arena: .*{message}"):
        main(["--scenes", "toy:any", "--out", str(tmp_path), *words])
    assert not contents(tmp_path)


def test_learned_attacks_and_own_classes_are_made_by_name() -> None:
    policy = make_attack("policy:name=prbi-0")
    assert isinstance(policy, Learned) and policy.options["observation"]
    assert type(make_attack("agents.attacks.noise:NoPerturbation")).__name__ == "NoPerturbation"


def test_the_worst_attack_is_picked_on_the_screening_scenes(custom_classes: Path) -> None:
    """It is played there by every defender, with the same seeds, and named with each result."""
    attacks = ("--attacks", "noise", "mine_too:Shout:level=0.5", "--defenders", "none", "mine_too:Halves")
    screen = ("--screen", "elsewhere:any", "--screen-scenes", "1", "--rank-by", "ap50", "damage")
    main([*SMALL, *attacks, *screen, "--no-videos"])
    out = custom_classes / "out" / "arena"
    data = json.loads((out / "arena.json").read_text())
    runs = [json.loads(file.read_text()) for file in (out / "runs").iterdir()]
    there = [run for run in runs if run["conditions"]["scenes"] == "elsewhere:any"]
    assert {(run["defender"], run["attack"], run["seed"]) for run in there} == {
        (run["defender"], run["attack"], run["seed"]) for run in runs
    }
    assert (data["ranked_by"], data["screening"]["scenes"]) == ("ap50", "elsewhere:any")
    assert [*data["further_rankings"]] == ["damage"] and data["about"]["screen"] == "elsewhere:any"
    for line in data["defenders"]:
        ((attack, n_scenes),) = line["opponents"]
        assert n_scenes == 2 and attack in attacks
        for measure in ("ap50", "damage"):
            values = data[measure][line["entry"]][attack].values()
            assert line[measure]["mean"] == pytest.approx(sum(values) / 2), "every column is under the attack named"
    assert sum(line["place"]["first"] for line in data["defenders"]) == pytest.approx(1)
    assert "1 scene of elsewhere:any" in (out / "arena.md").read_text()


# ── killed and gone on with ──────────────────────────────────────────────────────────────────────────────────────────

PAIRWISE = ("--defenders", "none", "prbi", "--attacks", "none", "pgd:steps=1", "--no-videos")


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """No plots are drawn."""
    monkeypatch.setattr(cli, "draw_plots", lambda results: {})


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("uninterrupted")
    main([*SMALL, *PAIRWISE, "--out", str(out)])
    return out


def table(out: Path) -> dict[str, Any]:
    """All results, but the speed and the command."""
    found: dict[str, Any] = untimed(json.loads((out / "arena.json").read_text()))
    return {**found, "about": None}


def untimed(found: Any) -> Any:
    """The same without what depends on how fast it was played."""
    if isinstance(found, dict):
        timed = ("frames_per_second", "milliseconds", "late")
        return {key: untimed(value) for key, value in found.items() if key not in timed}
    return [untimed(item) for item in found] if isinstance(found, list) else found


def alive(pid: int) -> bool:
    """Whether that process still runs."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="finds the workers in /proc")
def test_a_run_killed_by_force_goes_on_to_the_same_table(uninterrupted: Path, undrawn: None, tmp_path: Path) -> None:
    words = [*SMALL[:-1], "2", *PAIRWISE, "--out", str(tmp_path)]  # on two workers
    run = subprocess.Popen([sys.executable, "-m", "tests.helpers.toy_arena", *words], cwd=ROOT)
    cells, deadline = tmp_path / "runs", time.monotonic() + 240
    while not (cells.is_dir() and len(contents(cells)) >= 2):
        assert run.poll() is None and time.monotonic() < deadline, "it ended, or did nothing"
        time.sleep(0.02)
    workers = [int(pid) for pid in Path(f"/proc/{run.pid}/task/{run.pid}/children").read_text().split()]
    os.kill(run.pid, signal.SIGKILL)
    run.wait()
    kept, planned = contents(cells), contents(uninterrupted / "runs")
    assert 2 <= len(kept) < len(planned) and kept.keys() <= planned.keys()
    assert all(json.loads(data)["records"] for data in kept.values())  # whole, each of them
    main([*SMALL, *PAIRWISE, "--out", str(tmp_path)])
    assert contents(cells).keys() == planned.keys()
    assert {name: contents(cells)[name] for name in kept} == kept  # nothing is played twice
    assert table(tmp_path) == table(uninterrupted)
    while any(map(alive, workers)):
        assert time.monotonic() < deadline, "a worker outlives its parent"
        time.sleep(0.1)


def test_the_order_of_entries_changes_no_run(uninterrupted: Path, undrawn: None, tmp_path: Path) -> None:
    """Stored runs are taken for those of an arena that names its entries the other way round."""
    shutil.copytree(uninterrupted / "runs", tmp_path / "runs")
    before = contents(tmp_path / "runs")
    turned = ("--defenders", "prbi", "none", "--attacks", "pgd:steps=1", "none", "--no-videos", "--seeds", "8", "7")
    main([*SMALL, *turned, "--out", str(tmp_path)])
    assert contents(tmp_path / "runs") == before
    ranks = [{line["entry"]: line["rank"] for line in table(out)["defenders"]} for out in (tmp_path, uninterrupted)]
    assert ranks[0] == ranks[1]


def test_the_records_alone_hold_every_result(uninterrupted: Path) -> None:
    """Read without the plan: rows and worst cases come out as they were reported."""
    results: dict[Run, list[Record]] = {}
    for file in sorted((uninterrupted / "runs").iterdir()):
        data = json.loads(file.read_text())
        cell = Run(*(data[name] for name in ("defender", "attack", "k", "seed")), tuple(data["names"]))
        results[cell] = [Record.from_json(record) for record in data["records"]]
        assert data["conditions"]["frames"] == 3 and data["detector"]
    reported = json.loads((uninterrupted / "arena.json").read_text())
    rows = {(row.defender, row.attack): row for row in summarise(results, resamples=1)}
    for row in reported["rows"]:
        mine = rows[row["defender"], row["attack"]]
        for figure in ("ap50", "recovery70", "damage", "verifications", "mc_rate"):
            theirs, own = row[figure], getattr(mine, figure)
            assert own is None if theirs is None else theirs["mean"] == pytest.approx(own.mean)
    for ranking in reported["defenders"]:
        by_scene: dict[str, list[float]] = {}
        for cell, records in results.items():
            if (cell.defender, cell.attack) == (ranking["entry"], "pgd:steps=1"):
                for one in records:
                    by_scene.setdefault(one.scene, []).append(damage_per_frame(one, 3))
        worst = extremes({"pgd": {scene: sum(of) / len(of) for scene, of in by_scene.items()}}, max)
        assert ranking["damage"]["mean"] == pytest.approx(mean_interval(worst).mean)
