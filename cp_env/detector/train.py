"""Trains f_E and f_D together on random groups: `python -m cp_env.detector.train`.

Kill it whenever you like: it goes on from its last checkpoint, and ends with the weights it would have had, because
batches come from (seed, step) alone. The weights still need their operating threshold, which

    python -m cp_env.detector.evaluate --scenes town/calibration --weights runs/detector/mean.safetensors --calibrate

chooses and writes into them.
"""

from __future__ import annotations

import json
import logging
import math
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
import tyro
from tqdm import trange

from cp_env.detector.data import Batch, Footage, draw, prepare
from cp_env.detector.detector import Detector
from cp_env.detector.loss import detection_loss
from cp_env.detector.weights import read_detector, save_detector
from cp_env.scenes import open_source

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Args:
    """What a training run depends on."""

    out: Path = Path("runs/detector")  # checkpoint, loss curve, weights
    scenes: str = "town/train"
    stride: int = 2  # of the frames of each scene, one in so many
    steps: int = 2500
    frames: int = 6  # a step
    egos: int = 2  # centres a frame
    views: int = 4  # groups a centre
    agents: int = 5  # sensors a frame
    learning_rate: float = 3e-3  # at its highest: one cycle
    weight_decay: float = 1e-2
    init: Path | None = None  # weights to start from; by default random ones
    seed: int = 0
    threads: int = 2
    checkpoint_every: int = 100
    cache: Path | None = None  # of the rasterised sweeps; by default in the user's cache directory


def batch_loss(detector: Detector, batch: Batch) -> torch.Tensor:
    """L_det of all views of a batch: encode every sweep once, warp to every ego, fuse and decode every group."""
    maps = detector.encode_grids(batch.occupancy)[batch.agent]
    received = detector.warp(maps, batch.ego_T_sender)
    coverage = detector.coverage(batch.ego_T_sender)
    return detection_loss(detector.perceive(received, coverage, batch.world, batch.groups), batch.targets)


def learning_rate(step: int, args: Args) -> float:
    """One cycle: a rise over the first tenth, then a cosine down to a thousandth."""
    rise = max(args.steps // 10, 1)
    if step < rise:
        return args.learning_rate * (step + 1) / rise
    return args.learning_rate * max(0.5 * (1 + math.cos(math.pi * (step - rise) / max(args.steps - rise, 1))), 1e-3)


def train(args: Args, footage: list[Footage]) -> Detector:
    """Train, or go on training, until `args.steps`; checkpoints in `args.out`."""
    torch.set_num_threads(args.threads)
    with torch.random.fork_rng(devices=[]):  # torch's layers draw their first weights from the global generator
        torch.manual_seed(args.seed)
        detector = Detector() if args.init is None else read_detector(args.init)
    optimizer = torch.optim.AdamW(detector.parameters(), weight_decay=args.weight_decay)
    args.out.mkdir(parents=True, exist_ok=True)
    checkpoint = args.out / "checkpoint.pt"
    first = _resume(checkpoint, detector, optimizer)
    detector.train()
    smooth = 0.0
    for step in (bar := trange(first, args.steps, initial=first, total=args.steps, desc="training", mininterval=5)):
        batch = draw(
            footage,
            np.random.default_rng([args.seed, step]),
            frames=args.frames,
            egos=args.egos,
            views=args.views,
            agents=args.agents,
        )
        for group in optimizer.param_groups:
            group["lr"] = learning_rate(step, args)
        optimizer.zero_grad()
        loss = batch_loss(detector, batch)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(detector.parameters(), 10.0)
        optimizer.step()
        smooth = loss.item() if step == first else 0.98 * smooth + 0.02 * loss.item()
        bar.set_postfix(loss=f"{smooth:.3f}", refresh=False)
        if (step + 1) % args.checkpoint_every == 0 or step + 1 == args.steps:
            _checkpoint(checkpoint, detector, optimizer, step + 1)
            with (args.out / "loss.jsonl").open("a") as curve:
                curve.write(json.dumps({"step": step + 1, "loss": round(smooth, 4)}) + "\n")
    return detector


def _checkpoint(path: Path, detector: Detector, optimizer: torch.optim.Optimizer, step: int) -> None:
    partial = path.with_suffix(".part")
    torch.save({"model": detector.state_dict(), "optimizer": optimizer.state_dict(), "step": step}, partial)
    partial.rename(path)


def _resume(path: Path, detector: Detector, optimizer: torch.optim.Optimizer) -> int:
    """The step to go on with."""
    if not path.exists():
        return 0
    state = torch.load(path, weights_only=True)
    detector.load_state_dict(state["model"])
    optimizer.load_state_dict(state["optimizer"])
    log.info("going on from step %d of %s", state["step"], path)
    return int(state["step"])


def main(args: Args) -> None:
    """Prepare the sweeps, train, write the weights."""
    import platformdirs

    logging.basicConfig(level=logging.INFO, format="%(message)s")
    torch.set_num_threads(args.threads)
    cache = args.cache or Path(platformdirs.user_cache_dir("cp_env")) / "training"
    source = open_source(args.scenes)
    detector = train(args, prepare(source, cache, stride=args.stride))
    settings = {key: str(value) for key, value in asdict(args).items() if key not in ("out", "cache", "threads")}
    save_detector(detector, args.out / "mean.safetensors", trained={**settings, "source": source.digest})


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
