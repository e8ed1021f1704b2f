"""The page of a library, run where the library is installed; elsewhere its tests are skipped."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.helpers.pages import run_page
from tests.helpers.stand_in_town import Sketch


@pytest.fixture
def sketched_page(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[[str], dict[str, Any]]:
    """Run a page on a sketch of the town, in an empty folder; its names."""
    monkeypatch.setattr("cp_env.scenes.Town", Sketch)
    monkeypatch.chdir(tmp_path)
    return run_page
