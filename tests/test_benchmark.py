"""The benchmark: what it plans, that it can be killed, that its figures are those worked out by hand."""

from __future__ import annotations

import io
import itertools
import json
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from rich.console import Console

import agents
from cp_env.bank import SceneBank
from cp_env.detector import Detector
from cp_env.evaluation import (
    Cell,
    Crew,
    Protocol,
    Record,
    Row,
    Stage,
    Store,
    about,
    markdown,
    parse,
    plan,
    play,
    prepare,
    run,
    screen,
    summarise,
    write_report,
)
from cp_env.evaluation.film import film
from cp_env.game import Game
from cp_env.metrics import ApMeter
from cp_env.types import Detections
from defenders import Defender, Frame, Inspection, Verdict
from tests.toy import ToySource

SOURCE = ToySource(n_frames=6)
PROTOCOL = Protocol(SOURCE, SOURCE.names(), frames=3)
CELLS = plan(PROTOCOL, defenders=("none", "prbi"), attacks=("none", "pgd:steps=1"), ks=(2,), seeds=(7,), batch=1)


@pytest.fixture(scope="module")
def bank() -> SceneBank:
    """Random weights whose score bias lets two cells in a hundred pass."""
    torch.manual_seed(0)
    detector = Detector(channels=8).freeze()
    maps = detector.encode(SOURCE.sweeps(SOURCE.load("toy-0"), [0])[0])
    detector.decoder.head.bias[:4] -= detector.decode(maps.mean(0, keepdim=True)).logits.quantile(0.98)
    return SceneBank(SOURCE, detector, progress=False)


@pytest.fixture
def crew(bank: SceneBank) -> Crew:
    ticks = itertools.count()
    return Crew(make_attacker=agents.make, open_bank=lambda _: bank, clock=lambda: float(next(ticks)))


def contents(folder: Path) -> dict[str, bytes]:
    return {str(file.relative_to(folder)): file.read_bytes() for file in sorted(folder.rglob("*")) if file.is_file()}


def report(folder: Path) -> None:
    store = Store(folder)
    write_report(folder, summarise(store.load(CELLS, PROTOCOL), resamples=50), about(PROTOCOL, "python x.py"))


# ── the plan ─────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_the_plan_holds_every_combination_once_and_nobody_lies_only_without_liars() -> None:
    cells = plan(
        PROTOCOL, defenders=("none", "prbi"), attacks=("none", "pgd:steps=1"), ks=(1, 2), seeds=(0, 7), batch=1
    )
    assert len(cells) == len(set(cells)) == 2 * (1 + 2) * 2 * 2  # defenders × (none, k=1, k=2) × seeds × scenes
    assert {(cell.attack, cell.k) for cell in cells} == {("none", 0), ("pgd:steps=1", 1), ("pgd:steps=1", 2)}
    slugs = {cell.slug(protocol, name) for cell in cells for protocol in variants() for name in ("", "other")}
    assert len(slugs) == len(cells) * len(variants()) * 2


def variants() -> list[Protocol]:
    """Protocols that differ in one condition each: their results must never be mixed."""
    changes: list[dict[str, Any]] = [
        {},
        {"frames": 5},
        {"budget": 0.2},
        {"norm": "l2"},
        {"rsu": True},
        {"n_vehicles": 4},
    ]
    return [replace(PROTOCOL, **change) for change in changes]


def test_a_chunk_takes_so_many_scenes() -> None:
    cells = plan(PROTOCOL, defenders=("none",), attacks=("none",), ks=(1,), seeds=(0,), batch=4)
    assert [cell.names for cell in cells] == [("toy-0", "toy-1")]


@pytest.mark.parametrize(
    ("spec", "name", "knobs"),
    [
        ("prbi", "prbi", {}),
        ("prbi:threshold=calibrated", "prbi", {"threshold": "calibrated"}),
        (
            "pgd:steps=30,step_size=0.05,random_start=False",
            "pgd",
            {"steps": 30, "step_size": 0.05, "random_start": False},
        ),
    ],
)
def test_specs_name_knobs(spec: str, name: str, knobs: dict[str, Any]) -> None:
    assert parse(spec) == (name, knobs)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"ks": (0,)}, "at least 1"),
        ({"ks": (5,)}, "0 <= k < n"),
        ({"ks": (1, 1)}, "distinct"),
        ({"seeds": ()}, "at least one"),
        ({"defenders": ("prbi:epsilon",)}, "cannot read"),
        ({"batch": 0}, "batch"),
    ],
)
def test_a_plan_that_cannot_be_played_is_refused(change: dict[str, Any], message: str) -> None:
    good: dict[str, Any] = {"defenders": ("none",), "attacks": ("pgd",), "ks": (1,), "seeds": (0,)}
    with pytest.raises(ValueError, match=message):
        plan(PROTOCOL, **{**good, **change})


def test_unknown_scenes_and_an_empty_crew_are_refused() -> None:
    with pytest.raises(ValueError, match=r"unknown scenes \['nowhere'\]; known: toy-0, toy-1"):
        Protocol(SOURCE, ("nowhere",))
    with pytest.raises(ValueError, match="workers"):
        Crew(make_attacker=agents.make, workers=0)


# ── the play ─────────────────────────────────────────────────────────────────────────────────────────────────────────


@pytest.fixture(scope="module")
def whole(bank: SceneBank, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The plan played without interruption."""
    folder = tmp_path_factory.mktemp("whole")
    ticks = itertools.count()
    crew = Crew(make_attacker=agents.make, open_bank=lambda _: bank, clock=lambda: float(next(ticks)))
    assert list(prepare(CELLS, PROTOCOL, crew)) == ["toy-0", "toy-1"]
    assert list(run(CELLS, PROTOCOL, Store(folder), crew)) == CELLS
    report(folder)
    return folder


def failing(after: int) -> Callable[..., Any]:
    """`agents.make` that breaks down after so many attackers."""
    left = iter(range(after))

    def make(name: str, **knobs: Any) -> Any:
        if next(left, None) is None:
            raise KeyboardInterrupt
        return agents.make(name, **knobs)

    return make


@pytest.mark.parametrize("after", [1, len(CELLS) - 1])
def test_a_killed_run_goes_on_where_it_stopped_and_ends_byte_equal(
    whole: Path, crew: Crew, tmp_path: Path, after: int
) -> None:
    with pytest.raises(KeyboardInterrupt):
        list(run(CELLS, PROTOCOL, Store(tmp_path), replace(crew, make_attacker=failing(after))))
    assert len(contents(tmp_path)) == after

    rest = failing(len(CELLS) - after)  # one attacker more than is left would break down
    assert set(run(CELLS, PROTOCOL, Store(tmp_path), replace(crew, make_attacker=rest))) == set(CELLS)
    report(tmp_path)
    assert contents(tmp_path) == contents(whole)


def test_a_broken_cell_is_played_again(whole: Path, crew: Crew, tmp_path: Path) -> None:
    for name, data in contents(whole).items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(data)
    torn = Store(tmp_path).path(CELLS[3], PROTOCOL)
    torn.write_bytes(torn.read_bytes()[:200])
    assert Store(tmp_path).read(CELLS[3], PROTOCOL) is None
    assert len(list(run(CELLS, PROTOCOL, Store(tmp_path), replace(crew, make_attacker=failing(1))))) == len(CELLS)
    assert contents(tmp_path) == contents(whole)


def test_scenes_in_lock_step_give_what_each_gives_alone(whole: Path, crew: Crew, tmp_path: Path) -> None:
    pairs = plan(PROTOCOL, defenders=("prbi",), attacks=("pgd:steps=1",), ks=(2,), seeds=(7,), batch=2)
    list(run(pairs, PROTOCOL, Store(tmp_path), crew))
    together = Store(tmp_path).load(pairs, PROTOCOL)[pairs[0]]
    alone = Store(whole).load(CELLS, PROTOCOL)
    for record in together:
        cell = Cell("prbi", "pgd:steps=1", 2, 7, (record.scene,))
        assert replace(record, seconds=0.0).to_json() == replace(alone[cell][0], seconds=0.0).to_json()


def test_all_defenders_and_attacks_meet_the_same_liars(whole: Path) -> None:
    met: dict[tuple[str, int], set[tuple[int, ...]]] = {}
    for cell, (record,) in Store(whole).load(CELLS, PROTOCOL).items():
        assert len(record.liars) == cell.k
        assert len(record.damage) == PROTOCOL.frames
        met.setdefault((record.scene, cell.k), set()).add(record.liars)
    assert all(len(liars) == 1 for liars in met.values())


def test_the_seed_and_the_scene_decide_who_lies(bank: SceneBank) -> None:
    def liars(defender: str, seed: int) -> list[list[int]]:
        cell = Cell(defender, "pgd", 2, seed, PROTOCOL.names)
        drawn: list[list[int]] = Stage(cell, PROTOCOL, bank, agents.make("none")).world.attackers.tolist()
        return drawn

    assert liars("none", 7) == liars("prbi", 7)
    everyone = [tuple(pair) for seed in range(20) for pair in liars("none", seed)]
    assert {i for pair in everyone for i in pair} == {0, 1, 2, 3, 4}  # the ego too
    assert any(first != second for first, second in zip(everyone[::2], everyone[1::2], strict=True))


class Habit:
    """A learned attacker, as the stage sees one: always the same action."""

    def __init__(self, bank: SceneBank) -> None:
        self.knobs = {"action": "basis", "observation": "compact", "max_frames": 99}
        self.shapes: list[tuple[int, ...]] = []
        self.action = np.ones(Game(1, action="basis", bank=bank).single_action_space.shape, dtype=np.float32)

    def __call__(self, observations: np.ndarray) -> np.ndarray:
        self.shapes.append(observations.shape)
        return np.broadcast_to(self.action, (*observations.shape[:2], *self.action.shape))


def test_a_learned_attacker_plays_through_its_own_action_map(bank: SceneBank) -> None:
    cell, habit = Cell("none", "habit", 2, 7, PROTOCOL.names), Habit(bank)
    ticks = itertools.count()
    records = play(cell, PROTOCOL, bank, habit, clock=lambda: float(next(ticks)))
    assert [r.seconds for r in records] == [PROTOCOL.frames / 2] * 2  # a tick a step, shared by two worlds
    assert [len(r.damage) for r in records] == [PROTOCOL.frames] * 2  # the protocol's frames, not the attacker's
    assert [shape[:2] for shape in habit.shapes] == [(2, 2)] * PROTOCOL.frames
    assert sum(sum(r.damage) for r in records) > 0
    scripted = play(cell, PROTOCOL, bank, agents.make("none"))
    assert [r.liars for r in scripted] == [r.liars for r in records]


class Grumpy(Defender):
    """Fails in its third frame."""

    def reset(self, n_vehicles: int, rng: np.random.Generator) -> None:
        del n_vehicles, rng

    def inspect(self, frame: Frame) -> Inspection:
        yield from ()
        if frame.index == 2:
            raise RuntimeError("no more")
        return Verdict(range(frame.n_vehicles))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"defenders": ("prbbi",)}, "unknown defender 'prbbi'"),
        ({"defenders": ("prbi:wisdom=1",)}, "wisdom"),
        ({"defenders": ("tests.test_benchmark.Nobody",)}, "no defender 'tests.test_benchmark.Nobody'"),
        ({"defenders": ("no.such.module",)}, "name one of prbi"),
        ({"attacks": ("pdg",)}, "unknown attacker 'pdg'"),
    ],
)
def test_what_cannot_be_made_is_refused_before_anything_is_encoded(
    crew: Crew, change: dict[str, Any], message: str
) -> None:
    good: dict[str, Any] = {"defenders": ("none",), "attacks": ("pgd",), "ks": (1,), "seeds": (0,)}
    cells = plan(PROTOCOL, **{**good, **change})

    def never(_: Protocol) -> SceneBank:
        raise AssertionError

    with pytest.raises(ValueError, match=message):
        list(prepare(cells, PROTOCOL, replace(crew, open_bank=never)))


def test_a_defender_that_fails_ends_its_episode_and_is_named(crew: Crew, tmp_path: Path) -> None:
    name = f"{__name__}.Grumpy"  # a class of one's own, by its path
    cells = plan(PROTOCOL, defenders=(name,), attacks=("none",), ks=(1,), seeds=(0,))
    list(run(cells, PROTOCOL, Store(tmp_path), crew))
    for record in Store(tmp_path).load(cells, PROTOCOL)[cells[0]]:
        assert len(record.damage) == 3
        assert record.error is not None
        assert "no more" in record.error
    (row,) = summarise(Store(tmp_path).load(cells, PROTOCOL), resamples=10)
    assert row.n_errors == 2
    assert "Grumpy (2 failed)" in markdown([row])


# ── the figures ──────────────────────────────────────────────────────────────────────────────────────────────────────


def record(scene: str, hits: str, n_truth: int, **changes: Any) -> Record:
    """An episode of one frame of boxes: `hits` says, best score first, which are right ("1") and which wrong ("0")."""
    here = np.array([[10.0 * i, 0, 4, 2, 0] for i in range(n_truth)]).reshape(-1, 5)
    there = iter(here)
    found = [next(there) if hit == "1" else np.array([0.0, 50 + 9 * i, 4, 2, 0]) for i, hit in enumerate(hits)]
    meter = ApMeter((0.5, 0.7))
    meter.add(Detections(np.array(found).reshape(-1, 5), np.linspace(0.9, 0.1, len(hits))), here)
    plain: dict[str, Any] = {
        "liars": (1, 3),
        "n_maps": 5,
        "grace_frames": 1,
        "damage": (0.0, 0.5, 0.25),
        "similarity": (1.0, 0.2, 0.8),
        "verifications": (0, 2, 0),
        "suspects": (1,),
        "converged": None,
        "error": None,
        "seconds": 0.5,
    }
    return Record(scene=scene, meter=meter, **{**plain, **changes})


def rows_of(**groups: list[Record]) -> dict[str, Row]:
    """Rows by defender; a group's name is `defender__attack`."""
    played = {Cell(*name.split("__"), 0 if name.endswith("none") else 2, 0, ("x",)): of for name, of in groups.items()}
    return {f"{row.defender}__{row.attack}": row for row in summarise(played, resamples=200)}


def test_figures_by_hand() -> None:
    episodes = [
        record("a", "11", 2),
        record("a", "0", 2, suspects=(1, 2, 3), converged=2, verifications=(9, 4, 2), damage=(1.0, 1.0, 0.0)),
        record("b", "10", 4, suspects=(), converged=1, verifications=(0, 0, 0)),
    ]
    row = rows_of(prbi__pgd=episodes)["prbi__pgd"]
    # pooled, best first: 1, 0 and 1 of equal score 0.9 (precision 2/3 there), then 1 and 0 at 0.1: 3 of 8 found at 3/5
    assert row.ap50.mean == pytest.approx(2 / 8 * 2 / 3 + 1 / 8 * 3 / 5)
    assert row.ap70 == row.ap50
    assert row.n_scenes == 2
    assert row.n_episodes == 3
    assert row.damage.mean == pytest.approx(((0.75 + 2.0) / 2 + 0.75) / 2)  # scenes count alike
    assert row.verifications.mean == pytest.approx(((1 + 3) / 2 + 0) / 2)  # the grace frame's 9 are left out
    assert row.verifications_max == 9
    assert row.verifications_alarmed is not None
    assert row.verifications_alarmed.mean == pytest.approx((2 + 3) / 2)
    assert row.alarms.mean == pytest.approx(((0.5 + 1) / 2 + 0) / 2)
    assert row.converged.mean == pytest.approx((0.5 + 1) / 2)
    assert row.frames_to_convergence is not None
    assert row.frames_to_convergence.mean == pytest.approx((2 + 1) / 2)
    assert row.id_rate is not None
    assert row.id_rate.mean == pytest.approx(((0.5 + 1) / 2 + 0) / 2)
    assert row.mc_rate.mean == pytest.approx(((0 + 1 / 3) / 2 + 0) / 2)
    assert row.frames_per_second == pytest.approx(9 / 1.5)
    assert row.recovery50 is None


def test_recovery_is_the_share_of_the_lost_ap_that_comes_back() -> None:
    rows = rows_of(
        none__none=[record("a", "1111", 4, liars=()), record("b", "1111", 4, liars=())],
        none__pgd=[record("a", "10", 4), record("b", "10", 4)],
        prbi__pgd=[record("a", "111", 4), record("b", "111", 4)],
    )
    recovered = rows["prbi__pgd"].recovery50
    assert recovered is not None
    assert recovered.mean == pytest.approx((0.75 - 0.25) / (1 - 0.25))
    assert recovered.low <= recovered.mean <= recovered.high
    undefended = rows["none__pgd"].recovery50
    assert undefended is not None
    assert undefended.mean == 0
    assert rows["none__none"].recovery50 is None
    assert rows["none__none"].id_rate is None


def test_intervals_grow_with_the_spread_between_scenes_and_hold_the_mean() -> None:
    alike = rows_of(prbi__pgd=[record(f"{i}", "10", 2) for i in range(6)])["prbi__pgd"]
    unlike = rows_of(prbi__pgd=[record(f"{i}", "11" if i % 2 else "00", 2) for i in range(6)])["prbi__pgd"]
    assert alike.ap50.high - alike.ap50.low < 1e-9 < unlike.ap50.high - unlike.ap50.low
    assert unlike.ap50.low <= unlike.ap50.mean <= unlike.ap50.high


@pytest.mark.parametrize("hits", ["", "0", "1", "1101", "0101010111"])
def test_records_survive_being_written_down(hits: str) -> None:
    original = record("a", hits, 8, error="why", converged=2)
    copy = Record.from_json(json.loads(json.dumps(original.to_json())))
    assert copy.to_json() == original.to_json()
    for iou in (0.5, 0.7):
        assert copy.meter.value(iou) == pytest.approx(original.meter.value(iou), abs=1e-12)
        assert (copy.meter.matched(iou)[1] == original.meter.matched(iou)[1]).all()
    both = copy.meter.merge(original.meter)
    assert both.n_truth == 16
    assert both.value(0.5) == pytest.approx(original.meter.value(0.5))


# ── the report and the program ───────────────────────────────────────────────────────────────────────────────────────


def test_the_report_says_how_to_make_it_again(whole: Path) -> None:
    data = json.loads((whole / "results.json").read_text())
    assert data["about"]["command"] == "python x.py"
    assert data["about"]["protocol"]["names"] == ["toy-0", "toy-1"]
    assert data["about"]["versions"]["torch"]
    assert len(data["rows"]) == 4
    text = (whole / "results.md").read_text()
    tables = [[line for line in part.splitlines() if line.startswith("|")] for part in text.split("```")[::2]]
    for table in tables:
        assert len(table) == 2 + 4
        assert len({line.count("|") for line in table}) == 1


def test_the_table_fits_a_terminal_of_eighty_columns() -> None:
    rows = rows_of(
        none__none=[record("a", "1111", 4, liars=())], prbi__pgd=[record("a", "10", 4), record("b", "10", 4)]
    )
    rows["long"] = replace(rows["prbi__pgd"], defender="prbi:threshold=calibrated", n_errors=2)
    console = Console(width=80, file=io.StringIO())
    console.print(screen(list(rows.values())))
    shown = console.file.getvalue()  # type: ignore[attr-defined]
    assert max(map(len, shown.splitlines())) <= 80
    assert "…" not in shown
    assert "nobody lies" in shown
    assert "pgd, 2 liars" in shown


def test_a_film_has_a_picture_for_every_frame(bank: SceneBank) -> None:
    cell = Cell("prbi", "pgd:steps=1", 2, 0, ("toy-1",))
    pictures = film(cell, PROTOCOL, bank, agents.make)
    assert len(pictures) == PROTOCOL.frames
    assert len(film(cell, PROTOCOL, bank, agents.make, frames=2)) == 2
    assert any((a != b).any() for a, b in itertools.pairwise(pictures))


@pytest.fixture
def program(bank: SceneBank, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """`examples/benchmark.py`, on the toy scenes."""
    monkeypatch.setattr(sys, "argv", ["benchmark.py"])
    from examples import benchmark

    monkeypatch.setattr(benchmark, "open_source", lambda _: SOURCE)
    monkeypatch.setattr("cp_env.evaluation.cells.open_source", lambda _: SOURCE)
    monkeypatch.setattr(benchmark.evaluation, "open_bank", lambda _: bank)
    monkeypatch.setattr(benchmark.evaluation, "Crew", lambda **knobs: Crew(**knobs, open_bank=lambda _: bank))
    yield benchmark


def test_the_program_writes_tables_and_a_film_and_goes_on(
    program: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    args = program.Args(frames=2, defenders=("none",), attackers=("none", "pgd:steps=1"), ks=(2,), out=tmp_path / "out")
    program.main(args)
    assert {"results.json", "results.md", "episode.gif", "cells"} == {
        file.name for file in (tmp_path / "out").iterdir()
    }
    assert "AP@.5" in capsys.readouterr().out
    stamps = {file: file.stat().st_mtime_ns for file in (tmp_path / "out" / "cells").iterdir()}
    program.main(replace(args, gif=False))
    assert stamps == {file: file.stat().st_mtime_ns for file in (tmp_path / "out" / "cells").iterdir()}


def test_the_program_refuses_more_scenes_than_there_are(program: Any, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="n_scenes must be 1 to 2"):
        program.main(program.Args(n_scenes=3, out=tmp_path))
