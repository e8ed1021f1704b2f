"""Work spread over a Ray cluster: the machines need this package, and outsiders' classes, where Python finds them."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar

import torch

from cp_env.evaluation.execution.processes import Failure, Job, attempt

T = TypeVar("T")
RETRIES = 1
"""How often a job is given to another worker after its own has died."""


@contextmanager
def joined(address: str) -> Iterator[Any]:
    """The module `ray`, on a cluster: the one this process is on, or else one that is joined, and left at the end.

    `address` as in `ray.init`; "" is the cluster that runs here or is named by `RAY_ADDRESS`, or a new one.

    Raises ImportError, naming the extra, where ray is not installed.
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
    task: Callable[..., T], jobs: Sequence[Job], address: str, threads: int
) -> Iterator[tuple[int, T | Failure]]:
    """`task(*job)` for every job: its number and its result, as they come; the cluster as in `joined`."""
    with joined(address) as ray:
        remote = ray.remote(num_cpus=threads, max_retries=RETRIES)(_on_threads)
        pending = {remote.remote(task, job, threads): number for number, job in enumerate(jobs)}
        try:
            while pending:
                (done, *_), _ = ray.wait(list(pending))
                number = pending.pop(done)
                try:
                    result: T | Failure = ray.get(done)
                except ray.exceptions.RayError as error:
                    result = Failure(f"its worker died ({type(error).__name__})")
                yield number, result
        finally:  # an error, or a caller who stops asking
            for reference in pending:
                ray.cancel(reference, force=True)


def _on_threads(task: Callable[..., T], job: Job, threads: int) -> T | Failure:
    torch.set_num_threads(threads)
    return attempt(task, job)
