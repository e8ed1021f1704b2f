"""Trained weights: where they are, how they are read and written (safetensors; nothing is unpickled)."""

from __future__ import annotations

import json
import math
from functools import lru_cache
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import save_file

from cp_env.detector.model.bev import BEV
from cp_env.detector.model.detector import Detector
from cp_env.detector.model.fusion import FUSIONS
from cp_env.detector.model.tensors import read_metadata, read_tensors
from cp_env.scenes.formats.bounded import parse_json

FOLDER = Path(__file__).parent / "weights"
FORMAT = "cp_env detector 1"
ARCHITECTURE = ("format", "fusion", "channels", "threshold", "grid")
MAX_CHANNELS = 1024


def names() -> list[str]:
    """The detectors that ship with the package."""
    return sorted(path.stem for path in FOLDER.glob("*.safetensors"))


def load_detector(name: str = "mean", device: str = "cpu") -> Detector:
    """The trained detector of that name, frozen; the same object each time it is asked for.

    Raises:
        ValueError: unknown name, or its file is missing, broken, or made for another grid or architecture.
    """
    if name not in FUSIONS:
        raise ValueError(f"unknown detector {name!r}; known: {', '.join(FUSIONS)}")
    return _loaded(name, str(device))


@lru_cache(maxsize=8)
def _loaded(name: str, device: str) -> Detector:
    return read_detector(FOLDER / f"{name}.safetensors").to(device).freeze()


def save_detector(detector: Detector, path: Path, **notes: Any) -> None:
    """Write a detector that is not frozen, convolutions in half precision; `notes` go into the metadata as JSON."""
    tensors = {
        key: (tensor.half() if tensor.dim() == 4 else tensor).cpu().contiguous()
        for key, tensor in detector.state_dict().items()
    }
    about = {
        "format": FORMAT,
        "fusion": detector.fusion,
        "channels": detector.channels,
        "threshold": detector.threshold,
        "grid": str(BEV),
        **notes,
    }
    partial = path.with_suffix(".part")
    save_file(tensors, partial, metadata={key: json.dumps(value) for key, value in about.items()})
    partial.chmod(0o644)  # safetensors writes for the owner alone
    partial.rename(path)


def read_detector(path: Path) -> Detector:
    """The detector in a file, ready to be frozen or trained further.

    Raises:
        ValueError: the file is missing, broken, exceeds a bound of `tensors`, holds a number that is not finite, or is
            made for another grid or architecture.
    """
    try:
        metadata, tensors = read_tensors(path)
        about = {key: parse_json(value) for key, value in metadata.items()}
    except FileNotFoundError as error:
        raise ValueError(
            f"no weights at {path}: the file is missing; install the package again, or train a detector"
        ) from error
    except (OSError, ValueError) as error:
        raise ValueError(f"cannot read the weights in {path}: {error}; the file is broken, get it again") from error
    if about.get("format") != FORMAT or about.get("grid") != str(BEV):
        raise ValueError(
            f"the weights in {path} are of format {about.get('format')!r} for the grid {about.get('grid')!r}; "
            f"this version reads {FORMAT!r} for {str(BEV)!r}: train again"
        )
    if strange := [key for key, tensor in tensors.items() if not torch.isfinite(tensor).all()]:
        raise ValueError(f"the weights in {path} hold numbers that are not finite, in {strange[0][:80]}: train again")
    fusion, channels, threshold = (about.get(key, 0) for key in ("fusion", "channels", "threshold"))
    known = isinstance(fusion, str) and fusion in FUSIONS
    if not known or not _between(channels, 1, MAX_CHANNELS) or not _between(threshold, 0, 1):
        raise ValueError(
            f"the weights in {path} are of no detector: fusion {fusion!r:.40}, {channels!r:.40} channels, threshold "
            f"{threshold!r:.40}; fusion is one of {', '.join(FUSIONS)}, with 1 to {MAX_CHANNELS} channels"
        )
    detector = Detector(fusion=fusion, channels=int(channels), threshold=float(threshold))
    try:
        detector.load_state_dict({key: tensor.float() if tensor.dim() else tensor for key, tensor in tensors.items()})
    except RuntimeError as error:
        raise ValueError(f"the weights in {path} do not fit the detector: {str(error)[:1000]}") from error
    return detector


def about(path: Path) -> dict[str, Any]:
    """What a weights file says of itself beyond its architecture: how it was trained and calibrated."""
    return {key: parse_json(value) for key, value in read_metadata(path).items() if key not in ARCHITECTURE}


def _between(number: Any, low: float, high: float) -> bool:
    """Whether it is a finite number from `low` to `high`."""
    return type(number) in (int, float) and math.isfinite(number) and low <= number <= high
