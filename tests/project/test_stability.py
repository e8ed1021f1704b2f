"""docs/stability.md and the code say the same."""

from __future__ import annotations

import ast
import inspect
import re
import tomllib
from dataclasses import fields, is_dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import gymnasium
import pytest

import agents
import cp_env
import defenders

ROOT = next(folder for folder in Path(__file__).parents if (folder / "pyproject.toml").is_file())
PAGE = (ROOT / "docs/stability.md").read_text()


def section(heading: str) -> str:
    """The text below a heading of the page, down to the next."""
    return PAGE.split(f"\n## {heading}\n")[1].split("\n## ")[0]


@cache
def names(heading: str) -> tuple[str, ...]:
    """The dotted names of the section's block."""
    (block,) = re.findall(r"^```text\n(.*?)^```", section(heading), re.DOTALL | re.MULTILINE)
    return tuple(block.split())


STABLE, PROVISIONAL, RESERVED = names("Stable names"), names("Provisional names"), names("Reserved names")


def resolve(name: str) -> Any:
    """The object of a dotted name: modules as far as they go, then attributes or fields of a dataclass."""
    words = name.split(".")
    found: Any = import_module(words[0])
    for i, word in enumerate(words[1:], 2):
        if isinstance(found, ModuleType) and not hasattr(found, word):
            found = import_module(".".join(words[:i]))
        elif is_dataclass(found) and word in {field.name for field in fields(found)}:
            found = word
        else:
            found = getattr(found, word)
    return found


def parameters(function: Any) -> set[str]:
    """Names of all arguments, those of `**options: Unpack[Options]` one by one."""
    found = set()
    for parameter in inspect.signature(function).parameters.values():
        if parameter.kind is not parameter.VAR_KEYWORD:
            found.add(parameter.name)
            continue
        unpacked = re.fullmatch(r"(?:\w+\.)*Unpack\[(\w+)\]", str(parameter.annotation))
        assert unpacked, f"{function.__name__} takes **{parameter.name} of no known names: {parameter.annotation}"
        typed = _imported(import_module(function.__module__), unpacked[1])
        found |= typed.__required_keys__ | typed.__optional_keys__
    return found


def _imported(module: ModuleType, name: str) -> Any:
    """What `name` is in a module, if only under TYPE_CHECKING."""
    if hasattr(module, name):
        return getattr(module, name)
    for node in ast.walk(ast.parse(inspect.getsource(module))):
        if (
            isinstance(node, ast.ImportFrom)
            and node.module
            and name in {alias.asname or alias.name for alias in node.names}
        ):
            return getattr(import_module(node.module), name)
    raise AssertionError(f"{module.__name__} does not know {name}")


@pytest.mark.parametrize("name", STABLE + PROVISIONAL)
def test_a_listed_name_is_there(name: str) -> None:
    resolve(name)


def test_a_name_that_is_not_there_is_noticed() -> None:
    for name in ("cp_env.nothing", "cp_env.nothing.more", "defenders.Verdict.nothing"):
        with pytest.raises((AttributeError, ImportError)):
            resolve(name)


@pytest.mark.parametrize("name", RESERVED)
def test_a_reserved_name_is_not_there_yet(name: str) -> None:
    with pytest.raises((AttributeError, ImportError)):
        resolve(name)


def test_no_name_is_listed_twice() -> None:
    listed = STABLE + PROVISIONAL + RESERVED
    assert sorted(set(listed)) == sorted(listed)


@pytest.mark.parametrize("package", [cp_env, defenders, agents], ids=lambda package: package.__name__)
def test_every_exported_name_is_listed(package: ModuleType) -> None:
    exported = {f"{package.__name__}.{name}" for name in package.__all__}
    assert not exported - {*STABLE, *PROVISIONAL}


@pytest.mark.parametrize("package", [cp_env, defenders, agents], ids=lambda package: package.__name__)
def test_listed_names_at_the_top_of_a_package_are_exported(package: ModuleType) -> None:
    listed = [name.split(".") for name in STABLE + PROVISIONAL]
    top = {name for owner, name, *members in listed if owner == package.__name__ and not members}
    assert not top - set(package.__all__)


def test_every_option_of_an_environment_is_listed() -> None:
    listed = re.findall(r"^\| `(\w+)` \|", section("Stable options"), re.MULTILINE)
    assert sorted(listed) == sorted(parameters(cp_env.parallel_env))


def test_programs_and_ids_are_those_of_the_page() -> None:
    scripts = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]
    (sentence,) = re.findall(r"^So are the programs (.*?), and the id `(.*?)` ", section("Stable names"), re.MULTILINE)
    assert re.findall(r"`(.*?)`", sentence[0]) == list(scripts)
    assert sentence[1] == cp_env.ENV_ID and sentence[1] in gymnasium.registry
