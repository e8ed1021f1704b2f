"""The name `agents` is taken by other packages, too: whoever mixes them is told so."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import agents

ROOT = Path(agents.__file__).parent


def imported(folder: Path, code: str) -> str:
    """What an interpreter that finds packages in `folder` first says last."""
    run = subprocess.run(
        [sys.executable, "-c", f"import sys; sys.path.insert(0, {str(folder)!r}); {code}"],
        capture_output=True,
        text=True,
        cwd=folder,
        timeout=120,
    )
    return (run.stdout + run.stderr).strip().splitlines()[-1]


def test_a_strangers_module_in_our_folder_is_told(tmp_path: Path) -> None:
    ours = shutil.ignore_patterns("*.safetensors", "__pycache__")
    shutil.copytree(ROOT, tmp_path / "agents", ignore=ours)
    assert imported(tmp_path, "import agents; print(agents.__file__)") == str(tmp_path / "agents/__init__.py")
    (tmp_path / "agents/run.py").touch()
    said = imported(tmp_path, "import agents")
    assert said.startswith("ImportError: another package named `agents`") and "run.py" in said
    assert "openai-agents" in said


def test_a_strangers_init_over_ours_is_told(tmp_path: Path) -> None:
    shutil.copytree(ROOT, tmp_path / "agents", ignore=shutil.ignore_patterns("*.safetensors", "__pycache__"))
    (tmp_path / "agents/__init__.py").write_text("Runner = object\n")
    said = imported(tmp_path, "import agents.sb3")
    assert said.startswith("ImportError: the package `agents` that Python finds is not cp-env's"), said
