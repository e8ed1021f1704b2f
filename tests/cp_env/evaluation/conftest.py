"""The toy plan played once, without interruption, in this process."""

from __future__ import annotations

from pathlib import Path

import pytest

from agents.arena import make_attack
from cp_env.evaluation import Store, Workers, execute, prepare
from tests.helpers.toy_evaluation import CONDITIONS, RUNS, contents, report, ticking


@pytest.fixture
def workers() -> Workers:
    return ticking(make_attack=make_attack)


@pytest.fixture(scope="session")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("whole")
    workers = ticking(make_attack=make_attack)
    assert list(prepare(RUNS, CONDITIONS, workers)) == ["toy-0", "toy-1"]
    assert list(execute(RUNS, CONDITIONS, Store(folder), workers)) == RUNS
    report(folder)
    assert len(contents(folder)) == len(RUNS) + 2
    return folder
