"""What each split of scenes is: speeds, density, occlusion, and by how many single views a vehicle is found.

    python examples/reproduce/scene_statistics.py
    python examples/reproduce/scene_statistics.py --scenes town/test opv2v:/data/OPV2V?split=test

Speeds are those of all frames; the rest is counted in every `--every`-th frame, over the true vehicles within 32 m of
the ego in x and y. A vehicle is *returned* by a sensor that has 3 returns or more from it, within 32 m of the sensor,
and *found* by a single view whose boxes, at the operating threshold, hold one with an IoU of 0.5. The single views are
those of the first five connected vehicles, each one's map alone in the ego's grid.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
import tyro
from jaxtyping import Bool, Float, Int
from rich.console import Console
from rich.progress import track
from rich.table import Table

from cp_env.detector import load_detector
from cp_env.detector.model.detector import Detector
from cp_env.detector.model.weights import read_detector
from cp_env.detector.training.data import RETURNS_SEEN
from cp_env.geometry.boxes import pairwise_iou
from cp_env.geometry.planar import grid_origin
from cp_env.lidar.returns import returns_of
from cp_env.metrics.ground_truth import rows_in_range, truth_boxes
from cp_env.scenes import open_source
from cp_env.types import Scene, SceneSource, Sweep

STANDS = 0.3  # m/s
REACH = 32.0  # m: how far the map of a sensor reaches in x and y
VIEWS = (1, 2, 3, 5)


@dataclass
class Args:
    scenes: tuple[str, ...] = tuple(f"{r}/{s}" for r in ("town", "junction") for s in ("train", "calibration", "test"))
    n_vehicles: int = 5
    every: int = 13  # frames, from the fifth on
    limit: int | None = None  # so many scenes of each source only
    weights: Path | None = None  # by default those that ship
    threads: int = 1
    json: Path | None = None  # where to write the figures too


@dataclass(frozen=True)
class Split:
    """Figures of a split; shares are of vehicles in range of the ego, over frames and scenes."""

    scenes: int
    ego_speed: float  # m/s, median over scenes of the median over frames
    slowest: float  # m/s: of the scene whose ego's median is least
    fastest: float
    ego_stands: float  # share of its frames
    fleet_speed: float  # m/s, median over scenes of the median over connected vehicles and frames
    fleet_stands: float
    vehicles: float  # in range
    parked: float  # share of them that never move
    hidden: float  # share that the ego's sensor does not return
    returned: tuple[float, ...]  # share returned by at least 1, 2, 3, 5 of the sensors
    found: tuple[float, ...]  # share found by at least 1, 2, 3, 5 of the single views


def speeds(scene: Scene) -> Float[np.ndarray, "t A"]:
    """Of the connected vehicles between frames; m/s."""
    step: Float[np.ndarray, "t A"] = np.linalg.norm(np.diff(scene.pose[:, scene.connected, :2], axis=0), axis=-1)
    return step / scene.dt


def returned(scene: Scene, frame: int, sweeps: list[Sweep], rows: Int[np.ndarray, " L"]) -> Bool[np.ndarray, "N L"]:
    """Which sensors return which vehicles; a carrier knows where it is."""
    hits = np.array([returns_of(scene, frame, sweep)[rows] for sweep in sweeps]) >= RETURNS_SEEN
    origin = np.array([sweep.origin[:2] for sweep in sweeps])
    near = (np.abs(scene.pose[frame, rows, :2] - origin[:, None]) < REACH).all(axis=-1)
    carried: Bool[np.ndarray, "N L"] = scene.connected[: len(sweeps), None] == rows
    return hits & near | carried


@torch.no_grad()
def found(detector: Detector, scene: Scene, frame: int, sweeps: list[Sweep]) -> Bool[np.ndarray, "N L"]:
    """Which single views find which true boxes."""
    n = len(sweeps)
    sensors = np.stack([sweep.origin[:2] for sweep in sweeps])
    origin = grid_origin(sensors)
    pose = torch.from_numpy(np.pad(origin - origin[0], ((0, 0), (0, 1))).astype(np.float32))
    received, coverage = detector.warp(detector.encode(sweeps), pose), detector.coverage(pose)
    groups, world = torch.eye(n, dtype=torch.bool), torch.zeros(n, dtype=torch.long)
    dense = detector.perceive(received[None], coverage[None], world, groups)
    views = detector.detect(dense, np.repeat(sensors[:1] - origin[:1], n, axis=0))
    truth = truth_boxes(scene, frame, int(scene.connected[0]), detector.extent)
    boxes = [view.above(detector.threshold).boxes for view in views]
    return np.array([(pairwise_iou(truth, seen) >= 0.5).any(axis=1) for seen in boxes])


def at_least(by: Bool[np.ndarray, "N L"]) -> Float[np.ndarray, " K"]:
    """How many vehicles are seen by at least 1, 2, 3, 5 of the N."""
    return np.array([(by.sum(axis=0) >= n).sum() for n in VIEWS], dtype=float)


def describe(source: SceneSource, detector: Detector, args: Args) -> Split:
    """Figures of a source; casts the LiDAR and asks the detector in every `args.every`-th frame."""
    names = source.names()[: args.limit]
    ego, fleet = [], []
    vehicles, total = [], np.zeros((2, len(VIEWS)))
    parked = hidden = 0
    for name in track(names, f"describing {source.name}"):
        scene = source.load(name)
        ego.append(speeds(scene)[:, 0])
        fleet.append(speeds(scene)[:, : args.n_vehicles])
        still = ~np.isnan(scene.pose).any(axis=(0, 2)) & (np.ptp(scene.pose[..., :2], axis=0).max(axis=1) == 0)
        frames = list(range(4, scene.n_frames, args.every))
        for frame, sweeps in zip(frames, source.sweeps(scene, frames), strict=True):
            rows = rows_in_range(scene, frame, int(scene.connected[0]), detector.extent)
            met = returned(scene, frame, sweeps[: args.n_vehicles], rows)
            total += [at_least(met), at_least(found(detector, scene, frame, sweeps[: args.n_vehicles]))]
            vehicles.append(len(rows))
            parked += int(still[rows].sum())
            hidden += int((~met[0]).sum())
    medians = np.array([np.median(speed) for speed in ego])
    shares = total / sum(vehicles)
    return Split(
        scenes=len(names),
        ego_speed=float(np.median(medians)),
        slowest=float(medians.min()),
        fastest=float(medians.max()),
        ego_stands=float(np.mean([(speed < STANDS).mean() for speed in ego])),
        fleet_speed=float(np.median([np.median(speed) for speed in fleet])),
        fleet_stands=float(np.mean([(speed < STANDS).mean() for speed in fleet])),
        vehicles=float(np.mean(vehicles)),
        parked=parked / sum(vehicles),
        hidden=hidden / sum(vehicles),
        returned=tuple(shares[0].tolist()),
        found=tuple(shares[1].tolist()),
    )


def table(splits: dict[str, Split]) -> Table:
    """One column a split."""
    shown = Table("", *splits)
    for what, cell in {
        "scenes": lambda s: f"{s.scenes}",
        "ego: median speed, m/s (least … most)": lambda s: f"{s.ego_speed:.1f} ({s.slowest:.1f} … {s.fastest:.1f})",
        "ego stands, share of frames": lambda s: f"{s.ego_stands:.2f}",
        "connected: median speed, m/s": lambda s: f"{s.fleet_speed:.1f}",
        "connected stand, share of frames": lambda s: f"{s.fleet_stands:.2f}",
        "vehicles in range": lambda s: f"{s.vehicles:.1f}",
        "parked, share of them": lambda s: f"{s.parked:.2f}",
        "hidden from the ego": lambda s: f"{s.hidden:.2f}",
        "returned by ≥ 1, 2, 3, 5 sensors": lambda s: ", ".join(f"{x:.2f}" for x in s.returned),
        "found by ≥ 1, 2, 3, 5 single views": lambda s: ", ".join(f"{x:.2f}" for x in s.found),
    }.items():
        shown.add_row(what, *(cell(split) for split in splits.values()))
    return shown


def main(args: Args) -> None:
    torch.set_num_threads(args.threads)
    detector = load_detector() if args.weights is None else read_detector(args.weights).freeze()
    splits = {name: describe(open_source(name), detector, args) for name in args.scenes}
    Console(width=170).print(table(splits))
    if args.json is not None:
        args.json.write_text(json.dumps({name: asdict(split) for name, split in splits.items()}, indent=1) + "\n")


if __name__ == "__main__":
    main(tyro.cli(Args))
