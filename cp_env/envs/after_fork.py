"""What a forked process needs before it plays: torch on one thread.

The threads that torch computes with do not survive a fork, but their pool believes they do: a child of a process that
has computed on several threads waits for them for ever, in the first operation that is shared out. One thread needs no
pool. So environments run in children that were forked, as by gymnasium's `AsyncVectorEnv` or Stable-Baselines3's
`SubprocVecEnv`, whatever their parent has done.
"""

from __future__ import annotations

import os
import sys


def one_thread() -> None:
    """Let torch compute on one thread, if it is loaded and would take more."""
    torch = sys.modules.get("torch")
    if torch is not None and torch.get_num_threads() > 1:
        torch.set_num_threads(1)


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=one_thread)
