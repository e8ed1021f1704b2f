"""Sharing: several programs and processes on one folder, one cache or one environment give what one alone gives."""

from __future__ import annotations

import copy
import functools
import hashlib
import pickle
import shutil
import sys
import threading
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from random import Random
from typing import Any

import gymnasium
import numpy as np
import torch

from cp_env.envs.single import JointAdversaryEnv
from cp_env.world.scene_cache import SceneBank
from tests.campaign import programs
from tests.campaign.case import Case, Fault, Figures
from tests.campaign.kills import LIMIT
from tests.campaign.processes import ROOT, Program, started
from tests.helpers.toy_evaluation import toy_bank

PART = "sharing"
FRAMES = 4
OPTIONS: dict[str, Any] = {"max_frames": FRAMES, "action": "basis", "n_attackers": 2}


def cases(seed: int) -> list[Case]:
    """Two programs at once, a cache that is spoilt, vectors of processes, threads, and copies in mid-episode."""
    named: dict[str, Callable[[Path], Figures]] = {
        "two arenas on one folder of results": functools.partial(two_programs, "one folder"),
        "two arenas on one cold cache": functools.partial(two_programs, "one cache"),
        "the cache deleted again and again during an arena": functools.partial(spoilt, "deleted", seed),
        "bits of the cache flipped during an arena": functools.partial(spoilt, "flipped", seed),
        "a cache whose every file has a flipped bit": functools.partial(spoilt, "all flipped", seed),
    }
    for method in ("fork", "spawn"):
        named[f"AsyncVectorEnv by {method}"] = functools.partial(in_a_process, f"async {method}", 1)
        named[f"SubprocVecEnv by {method}"] = functools.partial(in_a_process, f"subproc {method}", 1)
    named["AsyncVectorEnv by fork after torch used two threads"] = functools.partial(in_a_process, "async fork", 2)
    named["four threads on one bank"] = functools.partial(in_a_process, "threads", 1)
    named["pickle and deepcopy in mid-episode"] = functools.partial(in_a_process, "copies", 1)
    return [Case(PART, f"{name}, seed {seed}", play) for name, play in named.items()]


# -- programs ---------------------------------------------------------------------------------------------------------


def arena(stack: ExitStack, folder: Path, out: Path, cache: Path) -> Program:
    words = programs.arguments("arena", out, seeds=2, workers=2)
    return stack.enter_context(started(words, folder, env={"CP_ENV_CACHE": str(cache)}))


def alone(folder: Path) -> Any:
    """The table of an arena that nobody disturbs."""
    with ExitStack() as stack:
        return result(arena(stack, folder, folder / "alone", folder / "cache-alone"), folder / "alone")


def result(program: Program, out: Path) -> Any:
    if program.wait(LIMIT) != 0:
        raise Fault(f"it ended with {program.process.returncode}: {program.said()}")
    return programs.table("arena", out)


def two_programs(share: str, folder: Path) -> Figures:
    """Two arenas at the same time on one folder of results, or on one cold cache with a folder each."""
    expected = alone(folder)
    outs = [folder / "out" / ("" if share == "one folder" else str(number)) for number in range(2)]
    with ExitStack() as stack:
        both = [arena(stack, folder, out, folder / "cache") for out in outs]
        tables = [result(program, out) for program, out in zip(both, outs, strict=True)]
    if any(table != expected for table in tables):
        raise Fault("the table differs from that of an arena alone")
    return {"tables": len(tables)}


def spoilt(how: str, seed: int, folder: Path) -> Figures:
    """One arena while its cache is deleted or damaged; or one on a cache that was damaged whole before."""
    expected, cache, rng, times = alone(folder), folder / "cache", Random(seed), 0
    if how == "all flipped":
        shutil.copytree(folder / "cache-alone", cache)
        for file in cache.rglob("*.maps"):
            flip(file, rng)
            times += 1
    with ExitStack() as stack:
        program = arena(stack, folder, folder / "out", cache)
        while not program.ended() and how != "all flipped":
            files = list(cache.rglob("*.maps"))
            if how == "deleted":
                times += bool(files)
                shutil.rmtree(cache, ignore_errors=True)
            elif files:
                times += flip(rng.choice(files), rng)
            program.process.poll()
            threading.Event().wait(0.05)
        table = result(program, folder / "out")
    if table != expected:
        raise Fault("the table differs from that of an arena whose cache is left alone")
    if not times:
        raise Fault("nothing was spoilt: the arena was over before")
    return {"spoilt": times}


def flip(file: Path, rng: Random) -> bool:
    """Flip one bit of a file, unless it is gone by now."""
    try:
        data = bytearray(file.read_bytes())
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        file.write_bytes(data)
    except (OSError, ValueError):
        return False
    return True


# -- environments -----------------------------------------------------------------------------------------------------


def in_a_process(what: str, threads: int, folder: Path) -> Figures:
    """One of `CHECKS` in a process of its own, whose torch uses so many threads first: a hang is seen."""
    words = ["-m", "tests.campaign.sharing", what, str(threads)]
    with started(words, folder, env={"CP_ENV_CACHE": str(folder / "cache")}) as program:
        if program.wait(600) != 0:
            raise Fault(f"it ended with {program.process.returncode}: {program.said()}")
        program.check_gone()
    return {"torch threads before": threads}


def make_env() -> JointAdversaryEnv:
    """A small environment; it can be made in any process."""
    return JointAdversaryEnv("prbi", bank=toy_bank(), **OPTIONS)


def actions(number: int) -> list[np.ndarray]:
    """Those of environment `number`, an episode long."""
    rng = np.random.default_rng(number)
    return [rng.uniform(-1, 1, 32).astype(np.float32) for _ in range(FRAMES)]


def played(env: JointAdversaryEnv, number: int) -> list[str]:
    """What an environment alone shows, frame by frame."""
    said = [digest(env.reset(seed=number)[0])]
    for action in actions(number):
        observation, reward, *_ = env.step(action)
        said.append(digest(observation, reward))
    return said


def digest(observation: Any, reward: float = 0.0) -> str:
    return hashlib.sha256(np.asarray(observation).tobytes() + np.float32(reward).tobytes()).hexdigest()[:16]


def check_vector(kind: str, method: str, count: int = 2) -> None:
    """Environments in processes of their own show what each shows alone; the last observation is that of a reset."""
    expected = [played(make_env(), number) for number in range(count)]
    steps = list(zip(*(actions(number) for number in range(count)), strict=True))
    if kind == "async":
        modes = {"autoreset_mode": gymnasium.vector.AutoresetMode.NEXT_STEP}
        envs = gymnasium.vector.AsyncVectorEnv([make_env] * count, context=method, **modes)
        observations = [envs.reset(seed=list(range(count)))[0]]
        rewards: list[Any] = [np.zeros(count)]
        for step in steps:
            observation, reward, *_ = envs.step(np.stack(step))
            observations, rewards = [*observations, observation.copy()], [*rewards, reward]
        envs.close()
    else:
        from stable_baselines3.common.vec_env import SubprocVecEnv

        vec = SubprocVecEnv([make_env] * count, start_method=method)
        vec.seed(0)
        observations, rewards = [vec.reset()], [np.zeros(count)]
        for step in steps:
            observation, reward, dones, infos = vec.step(np.stack(step))
            ends = [i["terminal_observation"] if d else o for o, d, i in zip(observation, dones, infos, strict=True)]
            observations, rewards = [*observations, np.stack(ends)], [*rewards, reward]
        vec.close()
    for number, said in enumerate(expected):
        shown = [digest(o[number], r[number]) for o, r in zip(observations, rewards, strict=True)]
        assert shown == said, f"environment {number} shows other frames than alone"


def check_threads() -> None:
    """Four threads, each with an environment of its own on one bank, at the same time."""
    expected = [played(make_env(), number) for number in range(4)]
    source = toy_bank()
    shared = SceneBank(source.source, source.detector, progress=False)
    envs = [JointAdversaryEnv("prbi", bank=shared, **OPTIONS) for _ in range(4)]
    found: dict[int, list[str]] = {}

    def work(number: int) -> None:
        found[number] = played(envs[number], number)

    threads = [threading.Thread(target=work, args=(number,)) for number in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [found.get(number) for number in range(4)] == expected, "a thread plays other frames than alone"


def check_copies() -> None:
    """After every frame, a pickled twin and a deep copy go on as the original does, and leave it alone."""
    expected = played(make_env(), 3)
    for cut in range(FRAMES):
        env = make_env()
        env.reset(seed=3)
        for action in actions(3)[:cut]:
            env.step(action)
        twins = {"pickled": pickle.loads(pickle.dumps(env)), "deep copy": copy.deepcopy(env), "original": env}
        for name, twin in twins.items():
            said = []
            for action in actions(3)[cut:]:
                observation, reward, *_ = twin.step(action)
                said.append(digest(observation, reward))
            assert said == expected[cut + 1 :], f"the {name} goes on otherwise after frame {cut}"


def main(words: Sequence[str]) -> None:
    """Run one check; an exception is its failure."""
    what, threads = words
    torch.set_num_threads(max(int(threads), 1))
    if int(threads) > 1:
        torch.randn(1000, 1000) @ torch.randn(1000, 1000)
        torch.nn.functional.conv2d(torch.randn(4, 16, 64, 64), torch.randn(16, 16, 3, 3))
    kind, _, method = what.partition(" ")
    if kind in ("async", "subproc"):
        check_vector(kind, method)
    elif kind == "threads":
        check_threads()
    else:
        check_copies()


if __name__ == "__main__":
    sys.path.insert(0, str(ROOT))
    main(sys.argv[1:])
