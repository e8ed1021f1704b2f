"""The notebook `examples/first_steps.ipynb` runs from the top in a fresh process, and is stored without outputs."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

from tests.helpers.pages import ROOT, in_tests

NOTEBOOK = ROOT / "examples" / "first_steps.ipynb"
SKETCHED = """
import cp_env.scenes
from tests.helpers.stand_in_town import Sketch

cp_env.scenes.Town = Sketch
"""
"""The town is a sketch, as for the pages of the documentation."""


def cells() -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = json.loads(NOTEBOOK.read_text())["cells"]
    return found


def test_it_is_a_notebook_without_outputs() -> None:
    notebook = json.loads(NOTEBOOK.read_text())
    assert (notebook["nbformat"], notebook["nbformat_minor"]) == (4, 5)
    assert len({cell["id"] for cell in cells()}) == len(cells())
    for cell in cells():
        assert cell["cell_type"] in ("code", "markdown") and cell["source"]
        if cell["cell_type"] == "code":
            assert cell["outputs"] == [] and cell["execution_count"] is None
    assert cells()[0]["source"][0].startswith("# ")


def test_its_links_lead_somewhere() -> None:
    text = "".join(line for cell in cells() if cell["cell_type"] == "markdown" for line in cell["source"])
    links = [part.partition(")")[0] for part in text.split("](")[1:]]
    assert links and all((NOTEBOOK.parent / link).is_file() for link in links)


def test_it_runs_from_the_top(tmp_path: Path) -> None:
    code = [in_tests("".join(cell["source"])) for cell in cells() if cell["cell_type"] == "code"]
    program = tmp_path / "program.py"
    program.write_text("\n\n".join([SKETCHED, *code]))
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, str(program)], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=600
    )
    assert done.returncode == 0, done.stderr[-2000:]
    said = done.stdout.splitlines()
    assert sum(line.startswith("detection loss ") for line in said) == 3
    assert [line.split()[0] for line in said if " noise 0." in line] == ["none", "ego_only", "prbi"]
    assert any(line.startswith("after  16 frames") for line in said) and said[-1].startswith("learned 0.")
