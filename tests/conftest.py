"""One torch thread a worker, shapes checked at run time, and a cache directory of the session's own."""

from __future__ import annotations

import os
import shutil
import tempfile

IS_WORKER = "PYTEST_XDIST_WORKER" in os.environ  # a worker of pytest-xdist inherits the session's cache directory
os.environ.setdefault("OMP_NUM_THREADS", "1")  # before torch is imported
os.environ.setdefault("MPLBACKEND", "Agg")
if not IS_WORKER:
    os.environ["CP_ENV_CACHE"] = tempfile.mkdtemp(prefix="cp-env-tests-")  # before a scene bank is opened
    os.environ["CP_ENV_CALIBRATION"] = f"{os.environ['CP_ENV_CACHE']}/calibration"  # not the reader's own files

import pytest
import torch
from hypothesis import HealthCheck, settings
from jaxtyping import install_import_hook

torch.set_num_threads(1)
# an int may be given where a float is asked for, as in static typing
CHECKER = "beartype.beartype(conf=beartype.BeartypeConf(is_pep484_tower=True))"
install_import_hook(["cp_env", "defenders", "agents"], CHECKER)

settings.register_profile(
    "tests", deadline=None, max_examples=50, derandomize=True, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("tests")


def pytest_unconfigure(config: pytest.Config) -> None:
    """Throw the session's encoded features away."""
    if not IS_WORKER:
        shutil.rmtree(os.environ["CP_ENV_CACHE"], ignore_errors=True)
