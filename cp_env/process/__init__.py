"""What a process of ours does about the one that started it."""

from __future__ import annotations

from cp_env.process.parent import WorkerContext, end_with_parent, watch_in_worker

__all__ = ["WorkerContext", "end_with_parent", "watch_in_worker"]
