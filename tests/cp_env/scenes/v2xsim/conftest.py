"""A miniature of the set."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.helpers.v2xsim_sets import thin_set


@pytest.fixture(scope="session")
def thin(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return thin_set(tmp_path_factory.mktemp("v2xsim") / "thin")
