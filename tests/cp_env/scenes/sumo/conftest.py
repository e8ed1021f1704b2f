"""Tests that need the simulator are skipped where it is not installed."""

from __future__ import annotations

import pytest


@pytest.fixture
def simulator() -> None:
    pytest.importorskip("libsumo", reason="needs the extra sumo")
    pytest.importorskip("sumo", reason="needs the extra sumo")
