"""Digests of source files: they change with every file that an entry rests on, and with no other."""

from __future__ import annotations

import importlib
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import agents
import defenders
from cp_env.evaluation.plan import sources
from cp_env.evaluation.plan.runs import Conditions, Run
from cp_env.evaluation.plan.sources import calibration_digest, code_of
from defenders.calibration import own_file, write_part


@pytest.fixture
def fresh(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder from which modules are imported; nothing is remembered before or after."""
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    code_of.cache_clear()
    yield tmp_path
    code_of.cache_clear()
    sources._shipped.cache_clear()


def now(spec: str) -> str:
    importlib.invalidate_caches()
    code_of.cache_clear()
    return code_of("defender", spec)


def test_shipped_ones_have_one_and_options_do_not_matter() -> None:
    for family, names in (("defender", defenders.names()), ("attack", agents.names()), ("detector", ("cp_env",))):
        digests = {code_of(family, name) for name in names}  # type: ignore[arg-type]
        assert len(digests) == 1 and all(len(digest) == 16 for digest in digests)
    assert code_of("defender", "prbi:epsilon=0.4") == code_of("defender", "prbi")
    assert len({code_of("defender", "none"), code_of("attack", "none"), code_of("detector", "cp_env")}) == 3


def test_a_shipped_family_rests_on_every_file_of_its_folder(fresh: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    root = Path(defenders.__file__).parent
    shutil.copytree(root, fresh / "twin", ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setitem(sources.HOMES, "defender", ("twin", ("",)))
    sources._shipped.cache_clear()
    before = now("prbi")
    for path in (fresh / "twin" / "bayes" / "likelihood.py", next((fresh / "twin").rglob("*.json"))):
        path.write_bytes(path.read_bytes() + b"\n")
        after = now("prbi")
        assert after != before
        before = after


def test_a_class_of_yours_rests_on_what_it_imports_of_yours(fresh: Path) -> None:
    (fresh / "pack").mkdir()
    for file, text in {
        "pack/__init__.py": "",
        "pack/mine.py": "import numpy\nfrom . import near\nfrom pack.far import x\nimport defenders\n",
        "pack/near.py": "from .deep import y\n",
        "pack/deep.py": "from pack import mine\n",
        "pack/far.py": "x = 1\n",
        "pack/other.py": "z = 1\n",
        "alone.py": "import beside_it\nimport defenders, numpy\nraise SystemExit('never run')\n",
        "beside_it.py": "a = 1\n",
    }.items():
        (fresh / file).write_text(text)
    before = {spec: now(spec) for spec in ("pack.mine:A", "alone:A")}
    assert before == {spec: now(spec) for spec in before} and len(set(before.values())) == 2
    rests_on = {"pack.mine:A": ("mine", "near", "deep", "far", "__init__"), "alone:A": ()}
    for file in sorted(fresh.rglob("*.py")):
        old = file.read_text()
        file.write_text(old + "\n")
        changed = {spec for spec in before if now(spec) != before[spec]}
        assert ("pack.mine:A" in changed) == (file.parent.name == "pack" and file.stem in rests_on["pack.mine:A"]), file
        assert ("alone:A" in changed) == (file.parent == fresh), file
        file.write_text(old)


def test_a_file_that_an_option_names_counts(fresh: Path) -> None:
    (fresh / "weights.bin").write_bytes(b"1")
    spec = f"prbi:file={fresh / 'weights.bin'}"
    before = now(spec)
    (fresh / "weights.bin").write_bytes(b"2")
    assert now(spec) != before != now("prbi")


@pytest.mark.parametrize("spec", ["nowhere:A", "no.such.module:A", "sys:A", "tests.helpers:A", ".:A"])
def test_what_has_no_file_has_no_digest_or_one_and_never_fails(spec: str) -> None:
    assert isinstance(code_of("attack", spec), str)


def test_a_run_is_known_by_the_users_calibration_of_its_weights(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What a defender rests on is part of what was played; another detector's file is not."""
    monkeypatch.setenv("CP_ENV_CALIBRATION", str(tmp_path))
    conditions = Conditions("town/test", ("test-urban-00",))
    run = Run("bayes", "none", 0, 0, conditions.names)
    plain = run.identity(conditions, "feed")
    assert "calibration" not in plain and calibration_digest("") == ""
    write_part(own_file("beef"), "beef", "mean", "previous_frame", {"epsilon": {1: 0.1}})
    assert run.identity(conditions, "feed") == plain
    names = {run.slug(conditions, "feed")}
    for epsilon in (0.1, 0.2):
        write_part(own_file("feed"), "feed", "mean", "previous_frame", {"epsilon": {1: epsilon}})
        assert run.identity(conditions, "feed")["calibration"] == calibration_digest("feed")
        names.add(run.slug(conditions, "feed"))
    assert len(names) == 3
