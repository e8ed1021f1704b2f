"""A process that computed on several threads has children, by fork, that compute on one."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
PROGRAM = """
import os, sys, torch
import cp_env.envs.after_fork

torch.set_num_threads(2)
torch.nn.functional.conv2d(torch.randn(4, 16, 64, 64), torch.randn(16, 16, 3, 3))  # the threads of the pool begin
child = os.fork()
if child == 0:
    torch.nn.functional.conv2d(torch.randn(4, 16, 64, 64), torch.randn(16, 16, 3, 3))
    os._exit(torch.get_num_threads())
print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), torch.get_num_threads())
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="forks")
def test_a_forked_child_computes_on_one_thread_and_does_not_hang() -> None:
    run = subprocess.run([sys.executable, "-c", PROGRAM], cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert run.stdout.split() == ["1", "2"], run.stderr  # the parent keeps its threads


def test_a_process_without_torch_is_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    from cp_env.envs.after_fork import one_thread

    monkeypatch.delitem(sys.modules, "torch")
    one_thread()
    assert "torch" not in sys.modules
