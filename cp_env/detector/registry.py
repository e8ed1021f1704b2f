"""The family of detectors. A new one enters `DETECTORS`."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import nn

from cp_env.detector.model.base import PRECISIONS, BaseDetector
from cp_env.detector.protocol import DetectorLike
from defenders.registry import Registry, Spec, shown, unknown


def _own(*, fusion: str = "mean", weights: Path | None = None, precision: str = "float32") -> DetectorLike:
    from cp_env.detector.model.weights import load_detector, read_detector

    made = load_detector(fusion) if weights is None else read_detector(weights).freeze()
    return made.with_precision(precision)


def _coperception(
    *,
    checkpoint: Path,
    fusion: str = "mean",
    rounds: int = 3,
    resampling: str = "affine",
    all_boxes: bool = False,
) -> DetectorLike:
    from cp_env.detector.coperception import load_checkpoint

    return load_checkpoint(checkpoint, fusion=fusion, rounds=rounds, resampling=resampling, all_boxes=all_boxes)


DETECTORS: Registry[DetectorLike] = Registry(
    "detector",
    {"cp_env": _own, "coperception": _coperception},
    DetectorLike,
    methods=(("encode", "warp", "coverage", "perceive", "detect"),),
)
"""Our own with its shipped weights, coperception's from a checkpoint, and `module:Class` for yours."""


def open_detector(
    detector: str | DetectorLike = "cp_env",
    *,
    fusion: str = "mean",
    checkpoint: str | Path | None = None,
    device: str = "cpu",
    precision: str = "float32",
) -> DetectorLike:
    """A detector by its name, or the object itself, on `device`.

    Args:
        detector: "cp_env" (or "cp_env:weights=FILE"), "coperception" (or "coperception:checkpoint=FILE", with
            the options of `load_checkpoint`, as all_boxes=true), "module:Class" of yours with options or without, or an
            object.
        fusion: the fusion of a detector that is named.
        checkpoint: coperception's file; for `detector="coperception"` alone.
        device: as torch spells it.
        precision: of maps, fusion and decoder: "float32", or "bfloat16", which our own detector knows.

    Returns:
        The detector, frozen if it was opened by name.

    Raises:
        ValueError: an unknown name or option, a place that holds no detector (nothing of it is called then); a
            checkpoint without coperception's detector, or the reverse; a device that is not there; what `load_detector`
            and `coperception.load_checkpoint` raise; a precision that the detector does not know.
    """
    _check_device(device)
    spec = Spec.parse(detector) if isinstance(detector, str) else None
    name = type(detector).__name__ if spec is None else spec.name
    given = checkpoint is not None or (spec is not None and "checkpoint" in spec.options)
    if given != (name == "coperception") and (checkpoint is not None or name == "coperception"):
        raise ValueError(
            'detector="coperception" and its checkpoint="file" come together: '
            f"got detector={shown(name)} and checkpoint={shown(checkpoint)}"
        )
    if spec is None:
        return _precise(precision, _on(device, DETECTORS.make(detector)))
    options = {} if name not in DETECTORS.entries or "fusion" in spec.options else {"fusion": fusion}
    made = DETECTORS.make(detector, **options, **({} if checkpoint is None else {"checkpoint": checkpoint}))
    if spec.place is not None and isinstance(made, BaseDetector):
        made.freeze()
    return _precise(precision, _on(device, made))


def _precise(precision: str, detector: DetectorLike) -> DetectorLike:
    """The detector in that precision: itself if nothing but the default is asked for."""
    if precision not in PRECISIONS:
        raise unknown("precision", precision, PRECISIONS)
    if precision == "float32":
        return detector
    if not isinstance(detector, BaseDetector):
        raise ValueError(f"detector {type(detector).__name__} knows no precision but float32, not {shown(precision)}")
    precise: DetectorLike = detector.with_precision(precision)  # type: ignore[assignment]  # as whole as it was
    return precise


def precise(detector: str, precision: str) -> str:
    """The name of a detector with that precision as its option; the name itself for the default."""
    if precision == "float32":
        return detector
    return f"{detector}{',' if ':' in detector else ':'}precision={precision}"


def _check_device(device: str) -> None:
    """ValueError for a device that torch does not know or that is not there."""
    if not isinstance(device, str | torch.device):  # None would be torch's default
        raise ValueError(f"device must be a name, such as 'cpu' or 'cuda:0', not {shown(device)}")
    try:
        torch.empty(0, device=device)
    except (RuntimeError, AssertionError, NotImplementedError, TypeError) as error:
        raise ValueError(
            f"device {shown(device)} cannot be used here ({error}); use 'cpu', or a device that is"
        ) from error


def _on(device: str, detector: DetectorLike) -> DetectorLike:
    """The object itself, moved if it is a module that is elsewhere."""
    if detector.device.type == torch.device(device).type:
        return detector
    if not isinstance(detector, nn.Module):
        raise ValueError(f"the detector is on {detector.device}, not on {device}, and only a torch module can be moved")
    moved: DetectorLike = detector.to(device)
    return moved
