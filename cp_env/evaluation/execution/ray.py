"""Execution on a Ray cluster: every machine needs this package, and your own classes, where Python finds them."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar

import torch

from cp_env.evaluation.execution.processes import Call, Failure, attempt
from cp_env.world.allocator import keep_freed_memory

T = TypeVar("T")
RETRIES = 1
"""How often a call is given to another worker after its own has died."""


@contextmanager
def joined(address: str) -> Iterator[Any]:
    """The module `ray`, on a cluster: the one this process is on, or one that is joined and left at the end.

    Args:
        address: as in `ray.init`; "" is the cluster that runs here or is named by `RAY_ADDRESS`, or a new one.

    Raises:
        ImportError: ray is not installed; the message names the extra.
    """
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    try:
        import ray
    except ImportError as error:
        raise ImportError("a Ray cluster needs ray: pip install 'cp-env[ray]'") from error
    if ray.is_initialized():
        yield ray
        return
    ray.init(address=address or None, log_to_driver=False)
    try:
        yield ray
    finally:
        ray.shutdown()


def on_ray(
    task: Callable[..., T], calls: Sequence[Call], address: str, threads: int
) -> Iterator[tuple[int, T | Failure]]:
    """`task(*call)` for every call: its number and its result, as they come; the cluster as in `joined`."""
    with joined(address) as ray:
        remote = ray.remote(num_cpus=threads, max_retries=RETRIES)(_on_threads)
        pending = {remote.remote(task, call, threads): number for number, call in enumerate(calls)}
        try:
            while pending:
                (done, *_), _ = ray.wait(list(pending))
                number = pending.pop(done)
                try:
                    result: T | Failure = ray.get(done)
                except ray.exceptions.RayError as error:
                    result = Failure(f"its worker died ({type(error).__name__})")
                yield number, result
        finally:  # an error, or a caller that stops asking
            for reference in pending:
                ray.cancel(reference, force=True)


def _on_threads(task: Callable[..., T], call: Call, threads: int) -> T | Failure:
    torch.set_num_threads(threads)
    keep_freed_memory()
    return attempt(task, call)
