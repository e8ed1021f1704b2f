"""The toy plan played once, without interruption, in this process."""

from __future__ import annotations

from pathlib import Path

import pytest

from agents.arena import make_attacker
from cp_env.evaluation import Crew, Store, prepare, run
from tests.helpers.toy_evaluation import CELLS, PROTOCOL, contents, report, ticking


@pytest.fixture
def crew() -> Crew:
    return ticking(make_attacker=make_attacker)


@pytest.fixture(scope="session")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("whole")
    crew = ticking(make_attacker=make_attacker)
    assert list(prepare(CELLS, PROTOCOL, crew)) == ["toy-0", "toy-1"]
    assert list(run(CELLS, PROTOCOL, Store(folder), crew)) == CELLS
    report(folder)
    assert len(contents(folder)) == len(CELLS) + 2
    return folder
