"""Equal trajectories: whatever the process, the torch threads and the place in a batch, a world plays the same."""

from __future__ import annotations

import functools
import hashlib
import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
import tyro

import agents
import defenders
from cp_env.scenes import open_source
from cp_env.world.scene_cache import SceneBank
from cp_env.world.situation import Outcome
from cp_env.world.world import World
from tests.campaign.case import Case, Fault, Figures
from tests.campaign.processes import started

PART = "equality"
THREADS = (1, 2, 4)
BATCH = 4


@dataclass(frozen=True)
class Args:
    """Options of the program, which prints the digests of one world's trajectory at every place of a batch."""

    defender: str = "prbi"
    attack: str = "pgd:steps=2"
    scenes: str = "town/test"
    """or "toy" """
    frames: int = 8
    seed: int = 0
    threads: int = 1
    batches: tuple[int, ...] = (1,)
    """sizes of the batches; the world is played at every place of each"""


def cases(seed: int, *, scenes: str = "town/test") -> list[Case]:
    """One for every defender."""
    return [
        Case(PART, f"{name} on {scenes}, seed {seed}", functools.partial(play, Args(name, scenes=scenes, seed=seed)))
        for name in defenders.names()
    ]


def play(args: Args, folder: Path) -> Figures:
    """Play one world alone and in batches, in processes of other thread counts; all digests must be equal."""
    found: dict[str, str] = {}
    for threads in THREADS:
        batches = (1, BATCH) if threads == 1 else (1, 2)
        for turn in range(2 if threads == 1 else 1):  # the same again, in another process
            digests = _in_process(Args(**{**asdict(args), "threads": threads, "batches": batches}), folder)
            found |= {f"{threads} threads, turn {turn}, {place}": digest for place, digest in digests.items()}
    check(found)
    return {"trajectories": len(found), "frames": args.frames, "threads": "/".join(map(str, THREADS)), "batch": BATCH}


def check(found: dict[str, str]) -> None:
    """Fault unless all digests are equal."""
    first = next(iter(found.values()))
    if other := [where for where, digest in found.items() if digest != first]:
        raise Fault(f"a world plays other frames than {next(iter(found))}: {'; '.join(other)}")


def _in_process(args: Args, folder: Path) -> dict[str, str]:
    words = ["-m", "tests.campaign.equality"]
    given = {name: value for name, value in asdict(args).items() if value is not None}
    for name, value in given.items():
        words += [f"--{name}", *map(str, value if isinstance(value, tuple) else (value,))]
    with started(words, folder, env={"CP_ENV_CACHE": str(folder / "cache")}) as program:
        if program.wait(1800) != 0:
            raise Fault(f"it ended with {program.process.returncode}: {program.said()}")
        said: dict[str, str] = json.loads(program.log.read_text().splitlines()[-1])
    return said


def trajectories(args: Args, bank: SceneBank) -> Iterator[tuple[str, str]]:
    """The digest of the world's trajectory at each place of each batch."""
    for size in args.batches:
        for place in range(size):
            yield f"place {place} of {size}", trajectory(args, bank, size, place)


def trajectory(args: Args, bank: SceneBank, size: int, place: int) -> str:
    """Play a batch in which the world has that place; its neighbours have other seeds. Returns the world's digest."""
    seeds = [args.seed + (0 if e == place else 100 + e) for e in range(size)]
    world = World(size, defender=args.defender, bank=bank, max_frames=args.frames)
    world.reset(seeds)
    attack = agents.make(args.attack)
    attack.reset(size, [np.random.default_rng(seed) for seed in seeds])
    digest = hashlib.sha256()
    for _ in range(args.frames):
        outcome = world.step(attack.act(world.situation()))
        digest.update(told(outcome, place))
        if outcome.truncated[place]:
            break
    return digest.hexdigest()


def told(outcome: Outcome, e: int) -> bytes:
    """Everything about one world's frame, to the bit."""
    found, verdict = outcome.output[e].detections, outcome.verdicts[e]
    numbers = [outcome.damage[e], outcome.similarity[e], outcome.perturbation_norm[e], outcome.verifications[e]]
    arrays = found.boxes, found.scores, outcome.output[e].score_map
    parts = [np.asarray(number).tobytes() for number in (*numbers, *arrays)]
    words = (sorted(verdict.collaborators), sorted(verdict.suspects), verdict.converged, outcome.errors[e])
    groups = [sorted(group) for group in outcome.judgements[e].groups]
    return b"\0".join([*parts, repr((words, groups, outcome.attackers[e].tolist())).encode()])


def main(args: Args) -> None:
    """Print the digests as a line of JSON."""
    torch.set_num_threads(args.threads)
    if args.scenes == "toy":
        from tests.helpers.toy_evaluation import toy_bank

        bank = toy_bank()
    else:
        from cp_env.detector import load_detector

        bank = SceneBank(open_source(args.scenes), load_detector(), progress=False)
    print(json.dumps(dict(trajectories(args, bank))))


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
