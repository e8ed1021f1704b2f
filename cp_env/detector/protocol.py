"""The protocol of a detector under attack: few methods, so that yours can take the place of our own.

    class MyDetector(BaseDetector):                      # a torch module
        channels = 16
        def encode(self, sweeps): ...                    # [B] sweeps -> [B, C, H, W]: the maps that are shared
        def perceive(self, received, coverage, world, groups): ...    # -> Dense: a score and a box for every cell

    env = cp_env.parallel_env(detector=MyDetector().freeze())

The rest (`warp`, `coverage`, `detect`, `digest`) is inherited or written anew. Attacks differentiate through `warp` and
`perceive`; their objective, `adversarial.adversarial_loss`, speaks of `Dense` alone, whatever made it. So a detector
with another kind of output (anchors, points) says for every cell what its best guess is, and keeps the rest of it, for
`detect`, in a subclass of `Dense`. `cp_env.testing.check_detector` holds a detector to the rules.

A detector that decodes with parts of the ego's own sweep which are never sent is a `UsesEgoSweep` too. Detectors that
differ in `perceive` alone may share the cache of encoded scenes: they are `SharesMaps`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Bool, Float, Int, Shaped
from torch import Tensor

from cp_env.detector.model.decoder import Dense
from cp_env.types import Detections, Sweep
from defenders.protocol import EgoFusion


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
class UsesEgoSweep(Protocol):
    """A detector that decodes with parts of the ego's own sweep (the ego context), which are never sent."""

    def ego_context(self, sweeps: Sequence[Sweep]) -> Shaped[Tensor, "B ..."]:
        """The ego context of each sweep: what its decoder needs. Small, for the cache holds it for every frame."""
        ...

    def with_ego_context(self, ego_context: Shaped[Tensor, "E ..."]) -> DetectorLike:
        """The same detector bound to the ego context of E worlds."""
        ...


@runtime_checkable
class SharesMaps(Protocol):
    """A detector that says what its maps depend on: those of one `maps_digest` are encoded once for all of them."""

    @property
    def maps_digest(self) -> str:
        """Changes whenever an answer of `encode`, `warp` or `ego_context` would, whatever `perceive` does."""
        ...


def maps_digest(detector: DetectorLike) -> str:
    """What the detector's maps are cached under: its `maps_digest` if it has one, else the whole `digest`."""
    return detector.maps_digest if isinstance(detector, SharesMaps) else detector.digest


def with_ego_context(detector: DetectorLike, ego_context: Shaped[Tensor, "E ..."] | None) -> DetectorLike:
    """The detector bound to an ego context; the detector itself if there is none."""
    if ego_context is None:
        return detector
    assert isinstance(detector, UsesEgoSweep)
    return detector.with_ego_context(ego_context)


@runtime_checkable
class LinearFusion(Protocol):
    """A detector whose fusion may be linear in the maps: benign maps are then fused once for all perturbations."""

    def linear_weights(
        self, coverage: Float[Tensor, "E N H W"], world: Int[Tensor, " B"], groups: Bool[Tensor, "B N"]
    ) -> Float[Tensor, "B N H W"] | None:
        """The weight of every map in each cell of a group's fused map; None if the fusion is not linear."""
        ...

    def fuse(
        self,
        received: Float[Tensor, "E N C H W"],
        coverage: Float[Tensor, "E N H W"],
        world: Int[Tensor, " B"],
        groups: Bool[Tensor, "B N"],
    ) -> Float[Tensor, "B C H W"]:
        """f_F: one fused map for each group."""
        ...

    def decode(self, fused: Float[Tensor, "B C H W"]) -> Dense:
        """f_D: the decoder's output for each fused map."""
        ...


@runtime_checkable
class HasFusion(Protocol):
    """A detector that says how it fuses: what is calibrated on similarities depends on it."""

    fusion: str


def fusion_of(detector: DetectorLike, otherwise: str) -> EgoFusion:
    """The detector's fusion, or `otherwise` if it names none; with its digest, under which it is calibrated."""
    return EgoFusion(detector.fusion if isinstance(detector, HasFusion) else otherwise, calibration_digest(detector))


@runtime_checkable
class SharesCalibration(Protocol):
    """A detector that says what its calibration is known by: a precision that moves no similarity shares it."""

    @property
    def calibration_digest(self) -> str:
        """Changes whenever similarities or scores of views would, by more than they scatter."""
        ...


def calibration_digest(detector: DetectorLike) -> str:
    """What the detector's calibration is known by: its `calibration_digest` if it has one, else the whole `digest`."""
    return detector.calibration_digest if isinstance(detector, SharesCalibration) else detector.digest


def dtype_of(detector: DetectorLike) -> torch.dtype:
    """The precision of the maps that the detector fuses; single unless it says otherwise."""
    dtype: torch.dtype = getattr(detector, "dtype", torch.float32)
    return dtype
