"""The files that are read by other people's programs: citation, issue forms, public CI, hooks."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any

import pytest
import yaml

import cp_env

ROOT = next(folder for folder in Path(__file__).parents if (folder / "pyproject.toml").is_file())
FORMS = sorted((ROOT / ".github/ISSUE_TEMPLATE").glob("*.yml"))


def read(file: str | Path) -> Any:
    return yaml.safe_load((ROOT / file).read_text())


def test_the_citation_is_of_this_version_and_names_the_paper() -> None:
    citation = read("CITATION.cff")
    assert str(citation["version"]) == cp_env.__version__
    (paper,) = citation["references"]
    assert paper["title"].startswith("All Vehicles Can Lie") and len(paper["authors"]) == 6


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.stem)
def test_an_issue_form_asks_for_command_and_version(form: Path) -> None:
    """What GitHub wants of a form: name, description, body; fields with ids of their own and a label each."""
    content = read(form)
    assert {"name", "description", "body"} <= set(content)
    asked = [field for field in content["body"] if field["type"] != "markdown"]
    assert len({field["id"] for field in asked}) == len(asked)
    assert all(field["attributes"]["label"] for field in asked)
    assert all(field["attributes"]["options"] for field in asked if field["type"] in ("dropdown", "checkboxes"))
    required = " ".join(
        field["attributes"]["label"].lower() for field in asked if field.get("validations", {}).get("required")
    )
    assert all(re.search(word, required) for word in ("command", "version", "seed"))


def test_the_forms_are_these() -> None:
    assert [form.stem for form in FORMS] == ["external-evaluation", "fault", "new-attack", "new-defence"]


def test_public_ci_runs_the_same_checks() -> None:
    steps = read(".github/workflows/ci.yml")["jobs"]["check"]["steps"]
    assert "bash .ci/run" in [step.get("run") for step in steps]
    assert "3.11" in [step.get("with", {}).get("python-version") for step in steps]


def test_hooks_are_local_and_call_the_tools_of_lint() -> None:
    (repository,) = read(".pre-commit-config.yaml")["repos"]
    assert repository["repo"] == "local"
    called = {shlex.split(hook["entry"])[0] for hook in repository["hooks"] if hook["language"] == "system"}
    assert called == {f".venv/bin/{tool}" for tool in ("ruff", "mypy", "lint-imports")}


@pytest.mark.parametrize(
    ("subject", "fits"),
    [
        ("defenders.prbi: renew the reference", True),
        ("cp_env, docs: move", True),
        ('Revert "x"', True),
        ("Add a thing", False),
        ("defenders:", False),
    ],
)
def test_the_form_of_a_subject(subject: str, fits: bool) -> None:
    (hook,) = [hook for hook in read(".pre-commit-config.yaml")["repos"][0]["hooks"] if hook["id"] == "subject"]
    assert bool(re.search(hook["entry"], f"{subject}\n\nwhy\n", re.MULTILINE)) == fits


def test_the_image_ends_in_the_small_benchmark_and_copies_what_is_there() -> None:
    lines = (ROOT / "Dockerfile").read_text().splitlines()
    assert lines[-1] == 'CMD ["make", "demo"]'
    copied = [word for line in lines if line.startswith("COPY ") for word in line.split()[1:-1]]
    assert "pyproject.toml" in copied and all((ROOT / word).exists() for word in copied)
    ready = next(index for index, line in enumerate(lines) if line == "RUN make .venv/.installed")
    needed = {"Makefile", "constraints.txt", "pyproject.toml", "LICENSE", "cp_env", "defenders", "agents"}
    before = {word for line in lines[:ready] if line.startswith("COPY ") for word in line.split()[1:-1]}
    assert needed <= before, "an editable install needs them"
    assert {".venv*", "out", ".git"} <= set((ROOT / ".dockerignore").read_text().split())
