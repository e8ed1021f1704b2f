"""What a detector has to offer to be the victim: few methods, so that yours can take our own's place.

    class MyDetector(BaseDetector):                      # a torch module
        channels = 16
        def encode(self, sweeps): ...                    # [B] sweeps -> [B, C, H, W]: the maps that are shared
        def perceive(self, received, coverage, world, groups): ...    # -> Dense: a score and a box for every cell

    env = cp_env.parallel_env(detector=MyDetector().freeze())

The rest (`warp`, `coverage`, `detect`, `digest`) is inherited or written anew. Liars differentiate through `warp` and
`perceive`; their objective, `adversarial.adversarial_loss`, speaks of `Dense` alone, whatever made it. So a detector
with another kind of output (anchors, points) says for every cell what its best guess is, and keeps the rest of it, for
`detect`, in a subclass of `Dense`. `cp_env.testing.check_detector` holds a detector to the rules.

A detector that decodes with parts of the ego's own sweep which are never sent is a `KeepsSweep` too. Detectors that
differ in `perceive` alone may share the cache of encoded scenes: they are `SharesMaps`.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Bool, Float, Int, Shaped
from torch import Tensor, nn

from cp_env.detector import warp
from cp_env.detector.decoder import Dense
from cp_env.detector.detector import Detector
from cp_env.detector.shared import fingerprint
from cp_env.types import Detections, Sweep


@runtime_checkable
class DetectorLike(Protocol):
    """The victim: frozen, deterministic, differentiable in the maps. E worlds, N maps in each, B views.

    Maps of all worlds lie in grid frames of ±`extent` m (see `cp_env.types`); rows grow with y, columns with x.
    """

    channels: int  # C of the shared maps
    size: int  # H = W of them
    extent: float  # half their side, m
    threshold: float  # the score from which the ego acts on a box

    @property
    def digest(self) -> str:
        """Changes whenever any answer would: part of the key of whatever was played, and of maps (see `SharesMaps`)."""
        ...

    @property
    def device(self) -> torch.device:
        """Where its weights are, and what it is handed must be."""
        ...

    def encode(self, sweeps: Sequence[Sweep]) -> Float[Tensor, "B C H W"]:
        """f_E: the shared map of each sweep, in its own sensor's grid frame."""
        ...

    def warp(self, maps: Float[Tensor, "*n C H W"], ego_T_sender: Float[Tensor, "*n 3"]) -> Float[Tensor, "*n C H W"]:
        """f_T: sender maps in the ego's frame, linear in them; poses are (x, y, yaw) in m, m, rad."""
        ...

    def coverage(self, ego_T_sender: Float[Tensor, "*n 3"]) -> Float[Tensor, "*n H W"]:
        """1 in those cells of the ego's map that the sender's map covers, else 0."""
        ...

    def perceive(
        self,
        received: Float[Tensor, "E N C H W"],
        coverage: Float[Tensor, "E N H W"],
        world: Int[Tensor, " B"],
        groups: Bool[Tensor, "B N"],
    ) -> Dense:
        """f_F and f_D: what the ego, vehicle 0, perceives of the maps of group `groups[b]` in world `world[b]`.

        A group may lack the ego and may hold one vehicle; an empty one is a ValueError. No view depends on the others.
        """
        ...

    def detect(self, dense: Dense, own: Float[np.ndarray, "B 2"] | None = None) -> list[Detections]:
        """The boxes of each view, best first, without the ego, which stands at `own` [m] in its grid frame."""
        ...


@runtime_checkable
class KeepsSweep(Protocol):
    """A detector that perceives with what the ego keeps of its own sweep."""

    def keep(self, sweeps: Sequence[Sweep]) -> Shaped[Tensor, "B ..."]:
        """What an ego keeps of each sweep: small, for the cache holds it for every frame."""
        ...

    def beside(self, kept: Shaped[Tensor, "E ..."]) -> DetectorLike:
        """The same detector at the side of the egos of E worlds, who kept this."""
        ...


@runtime_checkable
class SharesMaps(Protocol):
    """A detector that says what its maps depend on: those of one `maps_digest` are encoded once for all of them."""

    @property
    def maps_digest(self) -> str:
        """Changes whenever an answer of `encode`, `warp` or `keep` would, whatever `perceive` does."""
        ...


def maps_digest(detector: DetectorLike) -> str:
    """What the detector's maps are cached under: its `maps_digest` if it has one, else the whole `digest`."""
    return detector.maps_digest if isinstance(detector, SharesMaps) else detector.digest


def at_side(detector: DetectorLike, kept: Shaped[Tensor, "E ..."] | None) -> DetectorLike:
    """The detector that perceives for egos who kept this; itself where nothing needs to be kept."""
    if kept is None:
        return detector
    assert isinstance(detector, KeepsSweep)
    return detector.beside(kept)


class BaseDetector(nn.Module):
    """A detector but for `channels`, `encode` and `perceive`: maps are warped, boxes found as our own detector does.

    `floor` is the lowest score a box is reported with. ValueError from `digest` if the state cannot be hashed.
    """

    channels: int
    size: int = 32
    extent: float = 32.0
    threshold: float = 0.3
    floor: float = 0.05

    def warp(self, maps: Float[Tensor, "*n C H W"], ego_T_sender: Float[Tensor, "*n 3"]) -> Float[Tensor, "*n C H W"]:
        """See `cp_env.detector.warp`: bilinear, whole cells copied, zeros where the sender's map does not reach."""
        return warp.warp(maps, ego_T_sender, self.extent)

    def coverage(self, ego_T_sender: Float[Tensor, "*n 3"]) -> Float[Tensor, "*n H W"]:
        """1 in those cells of the ego's map that the sender's map covers, else 0."""
        return warp.coverage(ego_T_sender, self.size, self.extent)

    def detect(self, dense: Dense, own: Float[np.ndarray, "B 2"] | None = None) -> list[Detections]:
        """The peaks of the score map, without overlaps and without the ego: see `Detector.detect`."""
        return Detector.detect(self, dense, own)  # type: ignore[arg-type]

    def freeze(self) -> BaseDetector:
        """Make this the victim: evaluation mode, no gradients to weights."""
        return self.eval().requires_grad_(False)

    @property
    def device(self) -> torch.device:
        """Where its weights and buffers are; the CPU if it has none."""
        tensors = [*self.parameters(), *self.buffers()]
        return tensors[0].device if tensors else torch.device("cpu")

    @property
    def digest(self) -> str:
        """A fingerprint of the class's name, the thresholds, and all weights and buffers."""
        name = f"{type(self).__module__}.{type(self).__qualname__}"
        return fingerprint(self, f"{name} {self.size} {self.extent} {self.floor} {self.threshold}")


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
    from cp_env.detector.weights import load_detector

    return load_detector(fusion, device)


def _on(device: str, detector: DetectorLike) -> DetectorLike:
    """The object itself, moved if it is a module that is elsewhere."""
    if detector.device.type == torch.device(device).type:
        return detector
    if not isinstance(detector, nn.Module):
        raise ValueError(f"the detector is on {detector.device}, not on {device}, and only a torch module can be moved")
    moved: DetectorLike = detector.to(device)
    return moved
