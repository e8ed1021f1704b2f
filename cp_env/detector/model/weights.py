"""Trained weights: where they are, how they are read and written (safetensors; nothing is unpickled)."""

from __future__ import annotations

import json
from functools import lru_cache
from pathlib import Path
from typing import Any

from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file

from cp_env.detector.model.bev import BEV
from cp_env.detector.model.detector import Detector
from cp_env.detector.model.fusion import FUSIONS

FOLDER = Path(__file__).parent / "weights"
FORMAT = "cp_env detector 1"
ARCHITECTURE = ("format", "fusion", "channels", "threshold", "grid")


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
        ValueError: the file is missing, broken, or made for another grid or architecture.
    """
    if not path.is_file():
        raise ValueError(f"no weights at {path}: the file is missing; install the package again, or train a detector")
    try:
        with safe_open(path, framework="pt") as file:
            about = {key: json.loads(value) for key, value in (file.metadata() or {}).items()}
            tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118 (not a dict)
    except (SafetensorError, OSError, json.JSONDecodeError) as error:
        raise ValueError(f"cannot read the weights in {path}: {error}; the file is broken, get it again") from error
    if about.get("format") != FORMAT or about.get("grid") != str(BEV):
        raise ValueError(
            f"the weights in {path} are of format {about.get('format')!r} for the grid {about.get('grid')!r}; "
            f"this version reads {FORMAT!r} for {str(BEV)!r}: train again"
        )
    detector = Detector(fusion=about["fusion"], channels=about["channels"], threshold=about["threshold"])
    try:
        detector.load_state_dict({key: tensor.float() if tensor.dim() else tensor for key, tensor in tensors.items()})
    except RuntimeError as error:
        raise ValueError(f"the weights in {path} do not fit the detector: {error}") from error
    return detector


def about(path: Path) -> dict[str, Any]:
    """What a weights file says of itself beyond its architecture: how it was trained and calibrated."""
    with safe_open(path, framework="pt") as file:
        return {key: json.loads(value) for key, value in file.metadata().items() if key not in ARCHITECTURE}
