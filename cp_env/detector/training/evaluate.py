"""Accuracy of a detector without an attack.

    cp-env evaluate --scenes town/test
    cp-env evaluate --scenes mine:Folder:folder=data --weights runs/mine/mean.safetensors --calibrate
    cp-env evaluate --scenes mine:Folder:folder=data --detector mine:Toy

AP of the first vehicles of every scene, fused in groups of growing size around the ego, vehicle 0 (strict, unless
`--protocol` says otherwise); the Jaccard similarity of consecutive frames, the ego's motion taken out; and how large
the shared features are, against which an attack's budget is to be judged.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
import tyro
from jaxtyping import Float
from rich.console import Console
from rich.table import Table

from cp_env.detector.model.weights import about, read_detector, save_detector
from cp_env.detector.protocol import DetectorLike, UsesEgoSweep, with_ego_context
from cp_env.detector.registry import open_detector
from cp_env.detector.training.data import RETURNS_SEEN
from cp_env.geometry.planar import grid_origin
from cp_env.lidar.returns import returns_of
from cp_env.metrics.average_precision import ApMeter
from cp_env.metrics.ground_truth import rows_in_range, truth_boxes
from cp_env.metrics.similarity import view_similarity_many
from cp_env.paths import use_current_folder
from cp_env.progress import track
from cp_env.scenes import open_source
from cp_env.types import Detections, Scene, SceneSource, Sweep, View

CHUNK = 5  # frames encoded together
GRID = tuple(np.round(np.arange(0.1, 0.71, 0.025), 3))  # operating thresholds tried

_NO_MAP = np.zeros((0, 0), dtype=np.float32)


@dataclass(frozen=True)
class Args:
    """Options of a measurement."""

    scenes: str = "town/test"
    detector: str = "cp_env"  # our own; coperception:checkpoint=FILE; or module:Class of yours
    weights: Path | None = None  # a file of our own detector's; by default the weights that ship
    fusion: str = "mean"  # of the weights that ship, or of a detector that leaves it open
    n_vehicles: int = 5
    rsu: bool = False  # with the road-side unit's map as the last one; one vehicle is enough then
    frames: int = 100  # of each scene
    start: int = 0  # its first frame of those
    limit: int | None = None  # so many scenes only
    protocol: str = "strict"  # how AP is counted: "strict" or "coperception" (see `cp_env.metrics.average_precision`)
    calibrate: bool = False  # choose the operating threshold on these scenes and write it into `weights`
    json: Path | None = None  # where to write the figures too
    device: str = "cpu"  # as torch spells it
    threads: int = 1


@dataclass(frozen=True, eq=False)
class Seen:
    """One frame: what groups of 1 … n vehicles detect (the ego first), and what is there."""

    scene: str
    origin: Float[np.ndarray, " 2"]
    detections: list[Detections]
    truth: Float[np.ndarray, "L 5"]
    n_visible: int  # vehicles in range of which the n sensors together have returns enough
    magnitude: tuple[float, float]  # of the ego's shared map: mean, 99th percentile


@dataclass(frozen=True)
class Report:
    """Clean figures of a detector. AP by group size, the ego always in the group."""

    n_frames: int
    ap50: tuple[float, ...]
    ap70: tuple[float, ...]
    jaccard: float  # of consecutive frames, everyone fused, at the operating threshold
    precision: float  # at the operating threshold, IoU 0.5
    recall: float
    threshold: float
    protocol: str  # of AP
    visible: float  # share of the truth that could be seen at all
    mean: float  # of the shared maps
    high: float  # their 99th percentile


def perceive_scenes(detector: DetectorLike, source: SceneSource, args: Args) -> Iterator[Seen]:
    """Every frame of every scene, in order."""
    names = source.names()[: args.limit]
    for name in track(names, f"evaluating {source.name}", unit="scene"):
        scene = source.load(name)
        if scene.n_connected < args.n_vehicles:
            raise ValueError(
                f"scene {name} holds {scene.n_connected} connected vehicles, not {args.n_vehicles}; ask for fewer"
            )
        if args.rsu and scene.rsu is None:
            raise ValueError(f"scene {name} has no road-side unit; leave --rsu out, or take other scenes")
        frames = range(args.start, min(args.start + args.frames, scene.n_frames))
        for start in range(0, len(frames), CHUNK):
            part = frames[start : start + CHUNK]
            for frame, sweeps in zip(part, source.sweeps(scene, part), strict=True):
                unit = sweeps[scene.n_connected :] if args.rsu else []
                yield perceive_frame(detector, scene, frame, [*sweeps[: args.n_vehicles], *unit])


@torch.no_grad()
def perceive_frame(detector: DetectorLike, scene: Scene, frame: int, sweeps: Sequence[Sweep]) -> Seen:
    """One frame through the whole detector; the first sweep is the ego's."""
    n = len(sweeps)
    maps = detector.encode(sweeps)
    sensors = np.stack([sweep.origin[:2] for sweep in sweeps])
    origin = grid_origin(sensors)
    shift = np.pad(origin - origin[0], ((0, 0), (0, 1))).astype(np.float32)
    pose = torch.from_numpy(shift).to(detector.device)
    received, coverage = detector.warp(maps, pose), detector.coverage(pose)
    groups = torch.ones(n, n, dtype=torch.bool, device=detector.device).tril()
    world = torch.zeros(n, dtype=torch.long, device=detector.device)
    context = detector.ego_context(sweeps[:1]) if isinstance(detector, UsesEgoSweep) else None
    dense = with_ego_context(detector, context).perceive(received[None], coverage[None], world, groups)
    ego = int(scene.connected[0])
    rows = rows_in_range(scene, frame, ego, detector.extent)
    returns = sum(returns_of(scene, frame, sweep)[rows] for sweep in sweeps)
    return Seen(
        scene.name,
        origin[0],
        detector.detect(dense, np.repeat(sensors[:1] - origin[:1], n, axis=0)),
        truth_boxes(scene, frame, ego, detector.extent),
        int(np.sum(returns >= RETURNS_SEEN)),
        (float(maps[0].mean()), float(maps[0].flatten().quantile(0.99))),
    )


def jaccard(seen: Sequence[Seen], threshold: float) -> float:
    """Mean similarity of consecutive frames of the same scene, everyone fused."""
    everyone = [frame.detections[-1] for frame in seen]
    views = [
        View(frozenset(), t, frame.origin, found, found.above(threshold), _NO_MAP)
        for t, (frame, found) in enumerate(zip(seen, everyone, strict=True))
    ]
    pairs = [(views[t - 1], views[t]) for t in range(1, len(seen)) if seen[t - 1].scene == seen[t].scene]
    return float(view_similarity_many(pairs).mean()) if pairs else float("nan")


def precision_recall(meter: ApMeter, threshold: float) -> tuple[float, float]:
    """At IoU 0.5 and a score threshold."""
    scores, hits = meter.matched(0.5)
    found = scores >= threshold
    return float(hits[found].sum() / max(found.sum(), 1)), float(hits[found].sum() / max(meter.n_truth, 1))


def meters(seen: Sequence[Seen], protocol: str = "strict") -> list[ApMeter]:
    """One for each group size."""
    filled = [ApMeter((0.5, 0.7), protocol) for _ in seen[0].detections]
    for frame in seen:
        for meter, detections in zip(filled, frame.detections, strict=True):
            meter.add(detections, frame.truth)
    return filled


def report(seen: Sequence[Seen], threshold: float, protocol: str = "strict") -> Report:
    """All figures of the frames; precision and recall are strict."""
    by_size = meters(seen, protocol)
    precision, recall = precision_recall(meters(seen)[-1], threshold)
    mean, high = np.mean([frame.magnitude for frame in seen], axis=0)
    return Report(
        n_frames=len(seen),
        ap50=tuple(meter.value(0.5) for meter in by_size),
        ap70=tuple(meter.value(0.7) for meter in by_size),
        jaccard=jaccard(seen, threshold),
        precision=precision,
        recall=recall,
        threshold=threshold,
        protocol=protocol,
        visible=sum(frame.n_visible for frame in seen) / max(sum(len(frame.truth) for frame in seen), 1),
        mean=float(mean),
        high=float(high),
    )


def calibrate(seen: Sequence[Seen]) -> float:
    """The operating threshold of largest F1 x Jaccard of consecutive frames: boxes that are right, and stay.

    Raises:
        ValueError: no threshold finds a vehicle that is there in two frames in a row.
    """
    full = meters(seen)[-1]

    def utility(threshold: float) -> float:
        precision, recall = precision_recall(full, threshold)
        return 2 * precision * recall / max(precision + recall, 1e-9) * jaccard(seen, threshold)

    best = max(GRID, key=utility)
    if not utility(best) > 0:  # nan where no scene has two frames
        raise ValueError(
            f"at no threshold from {GRID[0]:g} to {GRID[-1]:g} does the detector find a vehicle that is there, and "
            "find it again in the next frame; nothing was written. Train it longer, or give scenes of two frames"
        )
    return float(best)


def table(result: Report, rsu: bool = False) -> Table:
    """The figures for the screen; with `rsu` the last row fuses the road-side unit's map as well."""
    grid = Table(title=f"no attack, {result.n_frames} frames, {result.protocol} AP")
    grid.add_column("vehicles fused")
    grid.add_column("AP@0.5")
    grid.add_column("AP@0.7")
    for size, (ap50, ap70) in enumerate(zip(result.ap50, result.ap70, strict=True), start=1):
        fused = "1 (ego)" if size == 1 else f"{size - 1} and the RSU" if rsu and size == len(result.ap50) else str(size)
        grid.add_row(fused, f"{ap50:.3f}", f"{ap70:.3f}")
    return grid


def remarks(result: Report) -> str:
    """The other figures, in a sentence."""
    return (
        f"consecutive frames: Jaccard {result.jaccard:.3f} at threshold {result.threshold:.3f} (precision "
        f"{result.precision:.3f}, recall {result.recall:.3f}); visible to anyone: {result.visible:.3f} of the truth; "
        f"shared maps: mean {result.mean:.2f}, 99th percentile {result.high:.2f}"
    )


def main(args: Args) -> None:
    """Measure, or calibrate and measure."""
    use_current_folder()
    torch.set_num_threads(args.threads)
    if args.calibrate and args.weights is None:
        raise ValueError("calibration writes into the weights: name the file with --weights")
    if args.weights is not None and args.detector != "cp_env":
        raise ValueError(f"--weights are of the detector cp_env, not of {args.detector!r}; give one of the two")
    source = open_source(args.scenes)
    spec = args.detector if args.weights is None else f"cp_env:weights={args.weights}"
    detector = open_detector(spec, fusion=args.fusion, device=args.device)
    seen = list(perceive_scenes(detector, source, args))
    threshold = detector.threshold
    if args.calibrate and args.weights is not None:
        threshold = calibrate(seen)
        trained = read_detector(args.weights)
        trained.threshold = threshold
        save_detector(trained, args.weights, **{**about(args.weights), "calibrated": args.scenes})
    result = report(seen, threshold, args.protocol)
    console = Console(width=120)
    console.print(table(result, args.rsu))
    console.print(remarks(result), highlight=False)
    if args.json is not None:
        args.json.write_text(json.dumps(asdict(result), indent=2) + "\n")


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
