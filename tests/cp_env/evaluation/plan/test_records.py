"""Records on disk: they come back as they were, and a file that is not what was written is named and never counted."""

from __future__ import annotations

import base64
import json
import shutil
import warnings
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import cp_env
from cp_env.evaluation import Record, Store
from cp_env.evaluation.plan import records
from cp_env.evaluation.plan.checksum import (
    CHANGED,
    EMPTY,
    FOREIGN,
    UNLIKE,
    UNREADABLE,
    Fault,
    StoredRunWarning,
    stamp,
)
from tests.helpers.toy_evaluation import CONDITIONS, RUNS, record


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


RUN = next(run for run in RUNS if run.k == 2)
DATA = record(RUN.names[0], "1101", 4).to_json()


@pytest.mark.parametrize(
    "change",
    [
        {"attackers": [1.5]},
        {"attackers": "13"},
        {"attackers": [True]},
        {"damage": [[1.0]]},
        {"damage": ["1"]},
        {"n_maps": "5"},
        {"n_maps": 5.0},
        {"converged": 1.5},
        {"error": 3},
        {"seconds": None},
        {"informed": 1},
        {"scene": None},
        {"strange": 1},
        {"boxes": None},
        {"boxes": {**DATA["boxes"], "n_boxes": 10**18}},
        {"boxes": {**DATA["boxes"], "n_boxes": 3}},
        {"boxes": {**DATA["boxes"], "n_boxes": -1}},
        {"boxes": {**DATA["boxes"], "n_truth": 1.5}},
        {"boxes": {**DATA["boxes"], "protocol": "mine"}},
        {"boxes": {**DATA["boxes"], "scores": "!!"}},
        {"boxes": {**DATA["boxes"], "scores": base64.b64encode(zlib.compress(bytes(100 << 20))).decode()}},
        {"boxes": {**DATA["boxes"], "hits": {}}},
        {"damage": [-0.25] * len(DATA["damage"])},
        {"damage": [1e308] * len(DATA["damage"])},
        {"damage": [float("nan")] * len(DATA["damage"])},
        {"similarity": [1.5] * len(DATA["damage"])},
        {"verifications": [-1] * len(DATA["damage"])},
        {"verifications": [10**400] * len(DATA["damage"])},
        {"attackers": [-1, 2]},
        {"attackers": [1, 5]},
        {"suspects": [7]},
        {"n_maps": -5},
        {"grace_frames": -1},
        {"converged": len(DATA["damage"])},
        {"seconds": float("inf")},
        {"driving": {}},
        {"driving": []},
        {"driving": False},
        {"critical_boxes": {}},
        {"critical_boxes": 0},
    ],
)
def test_values_that_are_none_of_a_record(change: dict[str, Any]) -> None:
    with pytest.raises((ValueError, KeyError, TypeError)):
        Record.from_json(json.loads(json.dumps({**DATA, **change})))
    with pytest.raises((ValueError, KeyError)):
        Record.from_json({key: value for key, value in DATA.items() if key != next(iter(change))} | {"x": 1})


def rewritten(change: Callable[[dict[str, Any]], Any]) -> Callable[[Path, Path], Any]:
    """An edit by somebody who writes a checksum that fits."""

    def apply(path: Path, _: Path) -> None:
        content = json.loads(path.read_text())
        del content["checksum"], content["name"]
        change(content)
        path.write_text(stamp(path.stem, content))

    return apply


DAMAGE: dict[str, tuple[Callable[[Path, Path], Any], str]] = {
    "empty": (lambda path, _: path.write_bytes(b""), EMPTY),
    "cut": (lambda path, _: path.write_bytes(path.read_bytes()[:300]), CHANGED),
    "edited": (lambda path, _: path.write_text(path.read_text().replace('"damage": [0.0', '"damage": [1.0')), CHANGED),
    "older": (lambda path, _: path.write_text(json.dumps({"records": [DATA]})), CHANGED),
    "nested": (lambda path, _: path.write_text("[" * 10_000), CHANGED),
    "another's": (lambda path, other: shutil.copy(other, path), FOREIGN),
    "nested within": (rewritten(lambda content: content.update(records=json.loads("[" * 99 + "]" * 99))), UNLIKE),
    "doubled": (rewritten(lambda content: content["records"].append(content["records"][0])), UNLIKE),
    "none": (rewritten(lambda content: content.update(records=[])), UNLIKE),
    "a text": (rewritten(lambda content: content.update(records="toy-0")), UNLIKE),
    "numbers": (rewritten(lambda content: content.update(records=[1, 2.5])), UNLIKE),
    "lists": (rewritten(lambda content: content.update(records=[[]])), UNLIKE),
    "boxes a text": (rewritten(lambda content: content["records"][0].update(boxes="none")), UNLIKE),
    "hits a list": (rewritten(lambda content: content["records"][0]["boxes"].update(hits=[1])), UNLIKE),
    "hits a number": (
        rewritten(lambda content: content["records"][0]["boxes"].update(hits={"0.5": 3, "0.7": 3})),
        UNLIKE,
    ),
    "other scene": (rewritten(lambda content: content["records"][0].update(scene="toy-9")), UNLIKE),
    "other attackers": (rewritten(lambda content: content["records"][0].update(attackers=[1])), UNLIKE),
    "one attacker twice": (rewritten(lambda content: content["records"][0].update(attackers=[1, 1])), UNLIKE),
    "too many frames": (rewritten(lambda content: content["records"][0].update(damage=[0.0] * 99)), UNLIKE),
    "a folder": (lambda path, _: (path.unlink(), path.mkdir()), UNREADABLE),
    "a link to nothing that ends": (lambda path, _: (path.unlink(), path.symlink_to("/dev/zero")), UNREADABLE),
}


@pytest.fixture
def store(tmp_path: Path) -> Store:
    """Two stored runs."""
    store = Store(tmp_path)
    for run in (RUN, other_run()):
        store.write(run, CONDITIONS, [record(name, "1101", 4) for name in run.names])
    return store


def other_run() -> Any:
    return next(run for run in RUNS if run.k == 2 and run != RUN)


@pytest.mark.parametrize("damage", DAMAGE)
def test_a_file_that_was_not_written_so_is_named_and_not_counted(store: Store, damage: str) -> None:
    path, other = (store.path(run, CONDITIONS) for run in (RUN, other_run()))
    apply, kind = DAMAGE[damage]
    apply(path, other)
    assert store.examine(RUN, CONDITIONS) == Fault(path, kind)
    with pytest.warns(StoredRunWarning, match="1 stored runs in") as caught:
        found = store.load([RUN, other_run()], CONDITIONS)
    assert list(found) == [other_run()] and len(caught) == 1
    assert path.name in str(caught[0].message) and kind in str(caught[0].message)


def test_what_is_stored_and_what_is_missing_raise_no_warning(store: Store) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert store.read(RUN, CONDITIONS) is not None
        assert store.load(RUNS, CONDITIONS).keys() == {RUN, other_run()}


def test_the_identity_holds_versions_and_code(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    content = json.loads(store.path(RUN, CONDITIONS).read_text())
    assert content["identity"] == RUN.identity(CONDITIONS)
    assert content["identity"]["version"] == cp_env.__version__
    assert set(content["made_with"]) == {"python", "numpy", "torch"}
    before = RUN.slug(CONDITIONS)
    for name in RUN.identity(CONDITIONS):
        changed = {**RUN.identity(CONDITIONS), name: "another"}
        with monkeypatch.context() as patch:
            patch.setattr(type(RUN), "identity", lambda *_, changed=changed: changed)
            assert RUN.slug(CONDITIONS) != before, name


def test_a_large_file_is_not_read(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(records, "RECORD_BYTES", 100)
    assert store.examine(RUN, CONDITIONS) == Fault(store.path(RUN, CONDITIONS), UNREADABLE)
