"""Trains detectors on random groups: `python -m cp_env.detector.training.train`.

With no more words, f_E and f_D together, their maps fused by the mean. From those come, in some minutes each, the other
fusions with a decoder of their own behind the same encoder, whose maps are kept on disk:

    W=cp_env/detector/model/weights
    python -m cp_env.detector.training.train --fusion max --encoder $W/mean.safetensors --out runs/max

DiscoNet learns from a teacher that fuses points:

    python -m cp_env.detector.training.train --early --init $W/mean.safetensors --out runs/teacher
    python -m cp_env.detector.training.train --fusion disconet --encoder $W/mean.safetensors \\
        --teacher runs/teacher/early.safetensors --out runs/disconet

Kill it whenever you like: it goes on from its last checkpoint, and ends with the weights it would have had, because
batches come from (seed, step) alone. The weights still need their operating threshold, which

    python -m cp_env.detector.training.evaluate --scenes town/calibration+junction/calibration \\
        --weights runs/max/max.safetensors --calibrate

chooses and writes into them.

With `--precision bfloat16` layers compute in half precision, where the processor is faster at it; weights, moments and
the loss stay in single precision.
"""

from __future__ import annotations

import hashlib
import json
import logging
import math
from contextlib import nullcontext
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import torch
import tyro

from cp_env.detector.model.decoder import Dense
from cp_env.detector.model.detector import Detector
from cp_env.detector.model.weights import FOLDER, names, read_detector, save_detector
from cp_env.detector.training.checkpoint import resume, write_checkpoint
from cp_env.detector.training.data import Batch, RasterisedScene, draw, encode, prepare
from cp_env.detector.training.distillation import divergence, early_fusion, features, teach
from cp_env.detector.training.loss import detection_loss
from cp_env.paths import use_current_folder
from cp_env.progress import Progress, say
from cp_env.scenes import open_source
from cp_env.types import SceneSource

CHECKPOINT = "checkpoint.safetensors"


@dataclass(frozen=True)
class Args:
    """What a training run depends on."""

    fusion: str = "mean"
    out: Path = Path("runs/detector")  # checkpoint, loss curve, weights
    scenes: str = "town/train+junction/train"
    stride: int = 2  # of the frames of each scene, one in so many
    steps: int = 2500
    frames: int = 6  # a step
    egos: int = 2  # centres a frame
    views: int = 4  # groups a centre
    agents: int = 5  # sensors a frame
    learning_rate: float = 3e-3  # at its highest: one cycle
    weight_decay: float = 1e-2
    init: Path | None = None  # weights to start from, a file or a name that ships (mean); by default random ones
    encoder: Path | None = None  # weights, likewise, whose encoder stays as it is and whose decoder is started from
    teacher: Path | None = None  # weights of an early-fusion detector to learn from
    distillation: float = 10.0  # weight of what is learned of it
    early: bool = False  # fuse points, not maps: train a teacher
    seed: int = 0
    device: str = "cpu"  # as torch spells it; a run may go on on another
    precision: Literal["float32", "bfloat16"] = "float32"  # of the layers; weights are float32
    threads: int = 2
    checkpoint_every: int = 100
    cache: Path | None = None  # of the rasterised sweeps and their maps; by default in the user's cache directory

    def __post_init__(self) -> None:
        if self.encoder and (self.init or self.early):
            raise ValueError("--encoder keeps an encoder as it is, --init and --early train it: choose one")
        if self.early and self.fusion != "mean":
            raise ValueError(f"--early fuses no maps: leave --fusion at mean, not {self.fusion}")


def batch_loss(
    detector: Detector,
    batch: Batch,
    *,
    early: bool = False,
    teacher: Detector | None = None,
    weight: float = 0.0,
    half: bool = False,
) -> torch.Tensor:
    """L_det of all views of a batch: encode every sweep once, warp to every ego, fuse and decode every group.

    Args:
        detector: in training.
        batch: views and their targets.
        early: fuse the sweeps instead, encode and decode every group.
        teacher: its L_KD is added, times `weight`.
        weight: of L_KD.
        half: layers compute in bfloat16 where torch holds that to be safe; the loss is of single precision.

    Returns:
        The loss, a mean over the visible vehicles of the batch.
    """
    with torch.autocast(batch.occupancy.device.type, dtype=torch.bfloat16) if half else nullcontext():
        if early:
            fused = detector.encode_grids(early_fusion(batch, detector.extent))
        else:
            maps = (detector.encode_grids(batch.occupancy) if batch.maps is None else batch.maps)[batch.agent]
            received = detector.warp(maps, batch.ego_T_sender)
            fused = detector.fuse(received, detector.coverage(batch.ego_T_sender), batch.world, batch.groups)
        dense, known = features(detector, fused)
        taught = [] if teacher is None else teach(teacher, batch)
    loss = detection_loss(Dense(dense.logits.float(), dense.boxes.float()), batch.targets)
    if not taught:
        return loss
    return loss + weight * divergence([part.float() for part in known], [part.float() for part in taught])


def learning_rate(step: int, args: Args) -> float:
    """One cycle: a rise over the first tenth, then a cosine down to a thousandth."""
    rise = max(args.steps // 10, 1)
    if step < rise:
        return args.learning_rate * (step + 1) / rise
    return args.learning_rate * max(0.5 * (1 + math.cos(math.pi * (step - rise) / max(args.steps - rise, 1))), 1e-3)


def weights_file(weights: Path) -> Path:
    """The file itself, or that of the weights that ship under this name ("mean", "max", …)."""
    return FOLDER / f"{weights}.safetensors" if str(weights) in names() else weights


def begin(args: Args) -> Detector:
    """The detector before its first step."""
    with torch.random.fork_rng(devices=[]):  # torch's layers draw their first weights from the global generator
        torch.manual_seed(args.seed)
        if args.encoder is None and args.init is None:
            return Detector(fusion=args.fusion)
        if args.init is not None:
            detector = read_detector(weights_file(args.init))
            if detector.fusion != args.fusion:
                raise ValueError(
                    f"{args.init} fuses by {detector.fusion}, not {args.fusion}: name it, or use --encoder"
                )
            return detector
        known = read_detector(weights_file(Path(str(args.encoder))))
        detector = Detector(fusion=args.fusion, channels=known.channels, threshold=known.threshold)
        detector.encoder.load_state_dict(known.encoder.state_dict())
        detector.decoder.load_state_dict(known.decoder.state_dict())
        detector.encoder.requires_grad_(False)
        return detector


def train(args: Args, scenes: list[RasterisedScene]) -> Detector:
    """Train, or go on training, until `args.steps`; checkpoints in `args.out`."""
    torch.set_num_threads(args.threads)
    detector = begin(args).to(args.device)
    teacher = None if args.teacher is None else read_detector(weights_file(args.teacher)).to(args.device)
    if teacher is not None:
        teacher.eval().requires_grad_(False)
    optimizer = torch.optim.AdamW([p for p in detector.parameters() if p.requires_grad], weight_decay=args.weight_decay)
    args.out.mkdir(parents=True, exist_ok=True)
    first = resume(args.out / CHECKPOINT, detector, optimizer)
    detector.train()
    detector.encoder.train(args.encoder is None)
    say(f"plan: {args.steps - first} steps of {args.frames} frames on {len(scenes)} scenes, {args.threads} threads")
    with Progress("training", args.steps, initial=first) as progress:
        _steps(detector, teacher, optimizer, args, scenes, first, progress)
    return detector


def _steps(
    detector: Detector,
    teacher: Detector | None,
    optimizer: torch.optim.Optimizer,
    args: Args,
    scenes: list[RasterisedScene],
    first: int,
    progress: Progress,
) -> None:
    """The steps from `first` on, with checkpoints."""
    smooth = 0.0
    for step in range(first, args.steps):
        batch = draw(
            scenes,
            np.random.default_rng([args.seed, step]),
            frames=args.frames,
            egos=args.egos,
            views=args.views,
            agents=args.agents,
        ).to(args.device)
        for group in optimizer.param_groups:
            group["lr"] = learning_rate(step, args)
        optimizer.zero_grad()
        loss = batch_loss(
            detector,
            batch,
            early=args.early,
            teacher=teacher,
            weight=args.distillation,
            half=args.precision == "bfloat16",
        )
        loss.backward()
        torch.nn.utils.clip_grad_norm_(detector.parameters(), 10.0)
        optimizer.step()
        smooth = loss.item() if step == first else 0.98 * smooth + 0.02 * loss.item()
        progress.advance(note=f"loss {smooth:.3f}")
        if (step + 1) % args.checkpoint_every == 0 or step + 1 == args.steps:
            write_checkpoint(args.out / CHECKPOINT, detector, optimizer, step + 1)
            with (args.out / "loss.jsonl").open("a") as curve:
                curve.write(json.dumps({"step": step + 1, "loss": round(smooth, 4)}) + "\n")


def load(args: Args, source: SceneSource) -> list[RasterisedScene]:
    """The rasterised scenes, with the maps of the encoder if it is not trained."""
    import platformdirs

    cache = args.cache or Path(platformdirs.user_cache_dir("cp_env")) / "training"
    scenes = prepare(source, cache, stride=args.stride)
    if args.encoder is None:
        return scenes
    detector = read_detector(weights_file(args.encoder)).to(args.device)
    key = hashlib.sha256(f"{source.digest} {args.stride} {detector.maps_digest}".encode()).hexdigest()[:16]
    return encode(scenes, detector, cache / f"maps-{key}")


def main(args: Args) -> Path:
    """Prepare the sweeps, train, write the weights; returns their file."""
    use_current_folder()
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    torch.set_num_threads(args.threads)
    source = open_source(args.scenes)
    detector = train(args, load(args, source))
    settings = {
        key: str(value) for key, value in asdict(args).items() if key not in ("out", "cache", "threads", "device")
    }
    name = "early" if args.early else args.fusion
    path = args.out / f"{name}.safetensors"
    save_detector(detector, path, trained={**settings, "source": source.digest})
    return path


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
