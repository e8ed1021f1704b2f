"""Train a detector on your scenes; batches are random groups of vehicles, fused as the ego will fuse them.

    cp-train detector --scenes mine:Folder:folder=data --out runs/mine
    cp-train detector --scenes mine:Folder:folder=data --out runs/max --fusion max --encoder runs/mine/mean.safetensors
    cp-env evaluate --scenes mine:Folder:folder=calibration --weights runs/mine/mean.safetensors --calibrate

Kill it whenever you like: it goes on from its last checkpoint, and ends with the weights it would have had.
"""

from __future__ import annotations

from rich.console import Console

from cp_env.detector.training import train
from cp_env.detector.training.train import Args

__all__ = ["Args", "program"]


def program(args: Args, command: str) -> None:
    """Train, and say where the weights are and what comes next."""
    del command
    path = train.main(args)
    Console().print(
        f"{path}: trained for {args.steps} steps. Its operating threshold is still to be chosen: "
        f"cp-env evaluate --scenes CALIBRATION --weights {path} --calibrate",
        soft_wrap=True,
        highlight=False,
        markup=False,
    )
