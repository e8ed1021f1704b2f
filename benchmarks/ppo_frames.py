"""Frames a second that PPO gets, with the policy and its updates, and of two worker processes beside one:

    python -m benchmarks.ppo_frames                          # guided and basis, 8 and 16 worlds, all precisions
    python -m benchmarks.ppo_frames --processes 2            # and two processes at once against one

A frame is one of one world: two attackers of five act in it against PRBI. The environments are those of
`agents.sb3.make_vec_env` on `town/test`, with `agents.learning.ppo` of one rollout and one update. Seconds are the
processor's, one torch thread, medians over rounds; so another program disturbs them little.

With `--processes n` the same work is done by n processes at once, each with worlds of its own, and by one alone, in
turn. The ratio by processor time says what they lose by sharing caches and memory. The ratio by the wall clock is what
a user gets, and depends on what else runs: the load of the machine is printed beside it.
"""

from __future__ import annotations

import multiprocessing
import os
import statistics
import time
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import torch
import tyro

from agents.learning.ppo import make_ppo
from agents.sb3 import make_vec_env
from cp_env.detector.registry import open_detector
from cp_env.scenes import open_source
from cp_env.settings import PRECISIONS
from cp_env.world.allocator import keep_freed_memory
from cp_env.world.scene_cache import SceneBank

ATTACKERS = 2
MIXED = "mixed"
"""A detector in single precision whose gradients `guided` takes in bfloat16."""

Case = tuple[str, int, str, int, int]
"""Action, worlds, precision, frames of a rollout, rounds."""


@dataclass(frozen=True)
class Args:
    """What is timed."""

    actions: tuple[str, ...] = ("guided", "basis")
    worlds: tuple[int, ...] = (8, 16)
    precisions: tuple[str, ...] = (*PRECISIONS, MIXED)
    steps: int = 16  # frames of a rollout
    rounds: int = 3
    processes: int = 0  # at once against one; 0 leaves that out


@lru_cache(maxsize=1)
def bank(precision: str) -> SceneBank:
    torch.set_num_threads(1)
    keep_freed_memory()
    return SceneBank(open_source("town/test"), open_detector(precision=precision), progress=False)


def learner(action: str, worlds: int, precision: str, steps: int) -> Any:
    """PPO on its environments, past its first rollout, in which frames are read from the cache for the first time."""
    env = make_vec_env(
        worlds,
        "prbi",
        bank=bank(PRECISIONS[0] if precision == MIXED else precision),
        action=action,  # type: ignore[arg-type]
        gradient_precision="bfloat16" if precision == MIXED else None,
        knowledge="gray-box",
        max_frames=steps,
        n_attackers=ATTACKERS,
    )
    env.seed(0)
    model = make_ppo(env, 0, n_steps=steps, batch_size=64)
    return model.learn(steps * env.num_envs)


def again(model: Any, steps: int) -> None:
    """One rollout and one update, of the same scenes."""
    model.env.seed(0)
    model.learn(steps * model.env.num_envs)


def frames_a_second(action: str, worlds: int, precision: str, args: Args) -> float:
    """Of processor time."""
    model, seconds = learner(action, worlds, precision, args.steps), []
    for _ in range(args.rounds):
        start = time.process_time()
        again(model, args.steps)
        seconds.append(time.process_time() - start)
    return worlds * args.steps / statistics.median(seconds)


def work(case: Case, ready: Any, go: Any, spent: Any) -> None:
    """What one process does, once all are ready."""
    action, worlds, precision, steps, rounds = case
    model = learner(action, worlds, precision, steps)
    ready.release()
    go.wait()
    start = time.process_time()
    for _ in range(rounds):
        again(model, steps)
    spent.put(time.process_time() - start)


def seconds_of(n: int, case: Case) -> tuple[float, float]:
    """Seconds of the wall clock until the last of n processes is done, and of the processor, the mean of one."""
    context = multiprocessing.get_context("spawn")
    ready, go, spent = context.Semaphore(0), context.Event(), context.SimpleQueue()
    workers = [context.Process(target=work, args=(case, ready, go, spent)) for _ in range(n)]
    for worker in workers:
        worker.start()
    for _ in workers:
        ready.acquire()
    start = time.perf_counter()
    go.set()
    processor = statistics.fmean(spent.get() for _ in workers)
    wall = time.perf_counter() - start
    for worker in workers:
        worker.join()
    return wall, processor


def scaling(args: Args) -> str:
    """n processes beside one: the ratio of frames a second."""
    n, case = args.processes, (args.actions[0], args.worlds[0], args.precisions[0], args.steps, args.rounds)
    rounds = [(seconds_of(1, case), seconds_of(n, case)) for _ in range(args.rounds)]
    wall, processor = ([n * alone[i] / together[i] for alone, together in rounds] for i in (0, 1))
    load = ", ".join(f"{one:.1f}" for one in os.getloadavg())
    return (
        f"{n} processes against one, {case[0]}, {case[1]} worlds each: {statistics.median(processor):.2f} times the "
        f"frames for the same processor time each ({min(processor):.2f} to {max(processor):.2f}); by the wall clock "
        f"{statistics.median(wall):.2f} ({min(wall):.2f} to {max(wall):.2f}), load {load} on {os.cpu_count()} cores"
    )


def main(args: Args) -> None:
    for precision in args.precisions:
        for action in args.actions:
            if precision == MIXED and action == "basis":
                continue  # it takes no gradient
            for worlds in args.worlds:
                rate = frames_a_second(action, worlds, precision, args)
                print(f"{action}, {worlds} worlds, {precision}: {rate:.0f} frames a second", flush=True)
    if args.processes:
        print(scaling(args))


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
