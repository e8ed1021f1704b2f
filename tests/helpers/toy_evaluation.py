"""Toy runs, a toy bank that any process can open, records made by hand, and attacks and defenders that break down."""

from __future__ import annotations

import itertools
import os
import signal
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from agents.attacks.noise import NoPerturbation
from cp_env.detector import Detector
from cp_env.evaluation import Conditions, Record, Row, Run, Store, Workers, about, plan_runs, summarise, write_report
from cp_env.metrics.average_precision import ApMeter
from cp_env.types import Detections
from cp_env.world.scene_cache import SceneBank
from cp_env.world.situation import Situation
from defenders import Defender, Frame, Inspection, Verdict
from tests.helpers.toy_scenes import ToySource

SOURCE = ToySource(n_frames=6)
CONDITIONS = Conditions(SOURCE, SOURCE.names(), frames=3)
RUNS = plan_runs(CONDITIONS, defenders=("none", "prbi"), attacks=("none", "pgd:steps=1"), ks=(2,), seeds=(7,), batch=1)


@cache
def toy_bank() -> SceneBank:
    """Random weights whose score bias lets two cells in a hundred pass."""
    with torch.random.fork_rng():
        torch.manual_seed(0)
        detector = Detector(channels=8).freeze()
    maps = detector.encode(SOURCE.sweeps(SOURCE.load("toy-0"), [0])[0])
    detector.decoder.head.bias[:4] -= detector.decode(maps.mean(0, keepdim=True)).logits.quantile(0.98)
    return SceneBank(SOURCE, detector, progress=False)


def open_toy(conditions: Conditions) -> SceneBank:
    """What `Workers.open_bank` is to open."""
    del conditions
    return toy_bank()


def ticking(**options: Any) -> Workers:
    """Workers in this process whose clock counts how often it is read."""
    ticks = itertools.count()
    return Workers(open_bank=open_toy, clock=lambda: float(next(ticks)), **options)


def contents(folder: Path) -> dict[str, bytes]:
    """Every finished file below, drafts left out."""
    files = (file for file in sorted(folder.rglob("*")) if file.is_file() and not file.name.startswith("."))
    return {str(file.relative_to(folder)): file.read_bytes() for file in files}


def untimed(records: dict[Run, tuple[Record, ...]]) -> dict[Run, list[dict[str, Any]]]:
    """What does not depend on how fast it was played."""
    return {run: [_untimed(record.to_json()) for record in of] for run, of in records.items()}


def _untimed(record: dict[str, Any]) -> dict[str, Any]:
    driving = record["driving"] and {**record["driving"], "late_frames": 0}
    return {**record, "seconds": 0.0, "driving": driving}


def record(scene: str, hits: str, n_truth: int, **changes: Any) -> Record:
    """An episode of one frame of boxes: `hits` says, best score first, which are right ("1") and which wrong ("0")."""
    here = np.array([[10.0 * i, 0, 4, 2, 0] for i in range(n_truth)]).reshape(-1, 5)
    there = iter(here)
    found = [next(there) if hit == "1" else np.array([0.0, 50 + 9 * i, 4, 2, 0]) for i, hit in enumerate(hits)]
    meter = ApMeter((0.5, 0.7))
    meter.add(Detections(np.array(found).reshape(-1, 5), np.linspace(0.9, 0.1, len(hits))), here)
    plain: dict[str, Any] = {
        "attackers": (1, 3),
        "n_maps": 5,
        "grace_frames": 1,
        "damage": (0.0, 0.5, 0.25),
        "similarity": (1.0, 0.2, 0.8),
        "verifications": (0, 2, 0),
        "suspects": (1,),
        "converged": None,
        "error": None,
        "seconds": 0.5,
    }
    return Record(scene=scene, meter=meter, **{**plain, **changes})


def rows_of(**groups: list[Record]) -> dict[str, Row]:
    """Rows by defender; a group's name is `defender__attack`."""
    results = {Run(*name.split("__"), 0 if name.endswith("none") else 2, 0, ("x",)): of for name, of in groups.items()}
    return {f"{row.defender}__{row.attack}": row for row in summarise(results, resamples=200)}


def report(folder: Path) -> None:
    """The toy plan's report in the folder of its runs."""
    store = Store(folder)
    write_report(folder, summarise(store.load(RUNS, CONDITIONS), resamples=50), about(CONDITIONS, "python x.py"))


class Grumpy(Defender):
    """Fails in its third frame."""

    def reset(self, n_vehicles: int, rng: np.random.Generator) -> None:
        del n_vehicles, rng

    def inspect(self, frame: Frame) -> Inspection:
        yield from ()
        if frame.index == 2:
            raise RuntimeError("no more")
        return Verdict(range(frame.n_vehicles))


class Clumsy(NoPerturbation):
    """An attack that breaks down."""

    def act(self, situation: Situation) -> Float[Tensor, "E k C H W"]:
        raise RuntimeError(f"stumbled in frame {situation.frame[0]}")


class Fatal(NoPerturbation):
    """An attack that takes its process with it."""

    def act(self, situation: Situation) -> Float[Tensor, "E k C H W"]:
        os.kill(os.getpid(), signal.SIGKILL)
        raise AssertionError
