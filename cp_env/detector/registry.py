"""Detectors by name."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import nn

from cp_env.detector.protocol import DetectorLike

DETECTORS = ("cp_env", "coperception")
"""Names of detectors: our own with its shipped weights, and coperception's from a checkpoint."""


def open_detector(
    detector: str | DetectorLike = "cp_env",
    *,
    fusion: str = "mean",
    checkpoint: str | Path | None = None,
    device: str = "cpu",
) -> DetectorLike:
    """A detector by its name (with `fusion` and, for coperception's, `checkpoint`), or the object itself, on `device`.

    Raises:
        ValueError: an unknown name; a checkpoint without coperception's detector, or the reverse; what
            `load_detector` and `coperception.load_checkpoint` raise.
    """
    name = detector if isinstance(detector, str) else type(detector).__name__
    if isinstance(detector, str) and detector not in DETECTORS:
        raise ValueError(f"unknown detector {detector!r}: choose one of {', '.join(DETECTORS)}, or pass an object")
    if (checkpoint is not None) != (name == "coperception"):
        raise ValueError(
            'detector="coperception" and its checkpoint="file" come together: '
            f"got detector={name!r} and checkpoint={checkpoint!r}"
        )
    if not isinstance(detector, str):
        return _on(device, detector)
    if checkpoint is not None:
        from cp_env.detector.coperception import load_checkpoint

        return load_checkpoint(checkpoint, fusion=fusion, device=device)
    from cp_env.detector.model.weights import load_detector

    return load_detector(fusion, device)


def _on(device: str, detector: DetectorLike) -> DetectorLike:
    """The object itself, moved if it is a module that is elsewhere."""
    if detector.device.type == torch.device(device).type:
        return detector
    if not isinstance(detector, nn.Module):
        raise ValueError(f"the detector is on {detector.device}, not on {device}, and only a torch module can be moved")
    moved: DetectorLike = detector.to(device)
    return moved
