"""The catalogue applies to the tree as it is, and the program tells a mistake that is caught from one that is not.

All mutants are run by `python -m tests.mutants.run`, which takes minutes; here are the checks that take seconds.
"""

from __future__ import annotations

import ast
import json
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.mutants.catalogue import CATALOGUE, ROOMS
from tests.mutants.mutant import Mutant
from tests.mutants.run import (
    BROKEN,
    KILLED,
    NOT_APPLICABLE,
    SURVIVED,
    BrokenTreeError,
    Copy,
    Result,
    check_green,
    chosen,
    key_of,
    read_results,
    try_all,
    try_mutant,
)

ROOT = Path(__file__).parents[2]
NAMED = {"perturbation", "world", "verification", "similarity", "boxes", "metrics", "statistics", "prbi", "bayes"}


def test_there_are_enough_in_every_room() -> None:
    assert len(CATALOGUE) >= 60
    assert set(ROOMS) == NAMED
    assert all(len(room) >= 4 for room in ROOMS.values())


def test_names_are_distinct() -> None:
    assert len({mutant.name for mutant in CATALOGUE}) == len(CATALOGUE)
    assert len({(mutant.file, mutant.old, mutant.new) for mutant in CATALOGUE}) == len(CATALOGUE)


@pytest.mark.parametrize("mutant", CATALOGUE, ids=lambda mutant: mutant.name)
def test_a_mutant_applies_and_is_another_program(mutant: Mutant) -> None:
    text = (ROOT / mutant.file).read_text(encoding="utf-8")
    assert ast.dump(ast.parse(mutant.applied(text))) != ast.dump(ast.parse(text))
    assert mutant.tests
    for test in mutant.tests:
        path, _, name = test.partition("::")
        assert (ROOT / path).is_file(), path
        assert f"def {name}" in (ROOT / path).read_text(encoding="utf-8"), test


# -- the program, on a tiny tree -------------------------------------------------------------------------------------

MODULE = "def larger(a, b):\n    return a if a > b else b\n\n\ndef half(a):\n    return a / 2\n"
TESTS = "from tiny import larger\n\n\ndef test_larger():\n    assert larger(1, 2) == larger(2, 1) == 2\n"

CAUGHT = Mutant("smaller", "tiny/__init__.py", "a > b", "a < b", ("test_tiny.py",))
MISSED = Mutant("third", "tiny/__init__.py", "a / 2", "a / 3", ("test_tiny.py",))
GONE = Mutant("gone", "tiny/__init__.py", "a >= b", "a > b", ("test_tiny.py",))
TWICE = Mutant("twice", "tiny/__init__.py", "return a", "return b", ("test_tiny.py",))
UNTESTED = Mutant("untested", "tiny/__init__.py", "a > b", "a < b", ("test_tiny.py::test_of_no_name",))


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A git checkout of one module, its test, and an ignored file."""
    folder = tmp_path_factory.mktemp("tree")
    (folder / "tiny").mkdir()
    for name, text in (("tiny/__init__.py", MODULE), ("test_tiny.py", TESTS), (".gitignore", "out/\n")):
        (folder / name).write_text(text)
    (folder / "out").mkdir()
    (folder / "out/big").write_text("ignored")
    subprocess.run(["git", "init", "--quiet"], cwd=folder, check=True, timeout=60)
    return folder


@pytest.fixture
def copy(tree: Path, tmp_path: Path) -> Iterator[Copy]:
    yield Copy(tree, tmp_path / "copy", packages=("tiny",), plugins=())
    assert (tree / "tiny/__init__.py").read_text() == MODULE, "the tree itself is never touched"
    assert (tmp_path / "copy/tiny/__init__.py").read_text() == MODULE, "the copy is restored"


def test_killed_and_surviving_are_told_apart(copy: Copy) -> None:
    assert not (copy.folder / "out").exists()
    results: list[Result] = []
    check_green(copy, [CAUGHT, MISSED])
    try_all([copy], [MISSED, CAUGHT, GONE], results.append)
    assert {result.name: result.state for result in results} == {
        "third": SURVIVED,
        "smaller": KILLED,
        "gone": NOT_APPLICABLE,
    }
    (caught,) = [result for result in results if result.state == KILLED]
    assert "test_tiny.py::test_larger" in caught.caught_by


def test_what_was_not_tested_is_no_kill(copy: Copy) -> None:
    assert try_mutant(copy, UNTESTED).state == BROKEN
    assert try_mutant(copy, TWICE).state == NOT_APPLICABLE


def test_a_red_test_is_not_taken_for_a_kill(copy: Copy) -> None:
    test = copy.folder / "test_tiny.py"
    test.write_text(TESTS + "    assert larger(1, 1) == 2\n")
    with pytest.raises(BrokenTreeError, match=r"must pass without a mutant: FAILED test_tiny\.py::test_larger"):
        check_green(copy, [CAUGHT])


def test_packages_from_elsewhere_are_refused(tree: Path, tmp_path: Path) -> None:
    with pytest.raises(BrokenTreeError, match="must import its own"):
        Copy(tree, tmp_path / "copy", packages=("json",), plugins=())


def test_results_are_kept_while_mutant_file_and_tests_are_the_same(copy: Copy, tmp_path: Path) -> None:
    file = tmp_path / "results.jsonl"
    assert read_results(file) == {}
    result = Result("smaller", KILLED, 1.0, "a test", key_of(CAUGHT, copy.folder))
    file.write_text(json.dumps(vars(result)) + '\n{"name": "cut o')
    assert read_results(file) == {("smaller", result.key): result}
    with copy.mutated(MISSED):
        assert key_of(CAUGHT, copy.folder) != result.key
    assert key_of(CAUGHT, copy.folder) == result.key != key_of(MISSED, copy.folder)


def test_names_choose_and_unknown_ones_are_refused() -> None:
    assert chosen(()) == list(CATALOGUE)
    assert chosen([CATALOGUE[3].name]) == [CATALOGUE[3]]
    with pytest.raises(ValueError, match="no such mutants: x-y; the names are in"):
        chosen(["x-y", CATALOGUE[0].name])
