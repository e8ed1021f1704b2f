"""The detector: f_E, f_T, f_F and f_D behind one object, and the way from its output to boxes."""

from __future__ import annotations

import copy
from collections.abc import Sequence

import torch
from jaxtyping import Bool, Float, Int, Shaped
from torch import Tensor

from cp_env.detector.model.base import PRECISIONS, BaseDetector
from cp_env.detector.model.bev import BEV, rasterise
from cp_env.detector.model.decoder import Decoder, Dense
from cp_env.detector.model.encoder import Conv, Encoder
from cp_env.detector.model.fingerprint import fingerprint, refuse_empty
from cp_env.detector.model.fusion import FUSIONS
from cp_env.types import Sweep
from defenders.registry import unknown

TOGETHER = {"cpu": 16}
"""Views that are fused and decoded in one go, by kind of device: more maps than caches hold are slower, not faster."""

ELSEWHERE = 1024
"""The same for any other kind: their maps take 3 GB."""


class Detector(BaseDetector):
    """Random weights; `load_detector` gives the trained, frozen one.

    Attributes: `channels` C and `size` H = W of the shared maps, `extent` half their side (m), `map_size` h = w of the
    decoder's maps, `floor` the lowest score kept, `threshold` the score from which the ego acts on a box.
    """

    size = 32
    map_size = 64
    extent = 32.0
    floor = 0.05

    def __init__(self, *, fusion: str = "mean", channels: int = 128, threshold: float = 0.3) -> None:
        super().__init__()
        if fusion not in FUSIONS:
            raise ValueError(f"fusion must be one of {', '.join(FUSIONS)}, not {fusion!r}")
        self.fusion, self.channels, self.threshold = fusion, channels, threshold
        self.encoder = Encoder(BEV.slices, channels)
        self.fuser = FUSIONS[fusion](channels)
        self.decoder = Decoder(channels)
        self._exact = ""  # digest before weights were rounded

    def encode(self, sweeps: Sequence[Sweep]) -> Float[Tensor, "B C H W"]:
        """The shared map of each sweep, in its own sensor's grid frame."""
        return self.encode_grids(rasterise(sweeps))

    def encode_grids(self, occupancy: Shaped[Tensor, "B Z R R"]) -> Float[Tensor, "B C H W"]:
        """The shared map of each occupancy grid."""
        maps: Tensor = self.encoder(occupancy.to(self._weight))
        return maps.contiguous()

    def fuse(
        self,
        received: Float[Tensor, "E N C H W"],
        coverage: Float[Tensor, "E N H W"],
        world: Int[Tensor, " B"],
        groups: Bool[Tensor, "B N"],
    ) -> Float[Tensor, "B C H W"]:
        """One fused map for each row (world, members); vehicle 0 is the ego. A group may lack it, may hold one vehicle,
        but not none: ValueError."""
        refuse_empty(groups)
        fused: Tensor = self.fuser(received, coverage, world, groups)
        return fused

    def linear_weights(
        self, coverage: Float[Tensor, "E N H W"], world: Int[Tensor, " B"], groups: Bool[Tensor, "B N"]
    ) -> Float[Tensor, "B N H W"] | None:
        """The mean's weights: 1 over the members that cover the cell. None for the other fusions."""
        if self.fusion != "mean":
            return None
        members = coverage[world] * groups[..., None, None]
        return members / members.sum(1, keepdim=True).clamp(min=1)

    def decode(self, fused: Float[Tensor, "B C H W"]) -> Dense:
        """Scores and boxes for every cell of 1 m."""
        dense: Dense = self.decoder(fused)
        return dense

    def perceive(
        self,
        received: Float[Tensor, "E N C H W"],
        coverage: Float[Tensor, "E N H W"],
        world: Int[Tensor, " B"],
        groups: Bool[Tensor, "B N"],
    ) -> Dense:
        """What the ego's decoder makes of each group: `decode(fuse(...))`."""
        refuse_empty(groups)
        most = TOGETHER.get(received.device.type, ELSEWHERE)
        parts = [
            self.decode(self.fuse(received, coverage, rows, members))
            for rows, members in zip(world.split(most), groups.split(most), strict=True)
        ]
        if len(parts) == 1:
            return parts[0]
        return Dense(torch.cat([part.logits for part in parts]), torch.cat([part.boxes for part in parts]))

    def freeze(self) -> Detector:
        """Make this the victim: evaluation mode, normalisation folded into the convolutions, no gradient to weights."""
        self.eval()
        for module in self.modules():
            if isinstance(module, Conv):
                module.fold()
        self.decoder.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        return self.eval().requires_grad_(False)  # folding put fresh modules in

    def with_precision(self, precision: str) -> Detector:
        """The same detector with maps, fusion and decoder in that precision: itself in its own, else a copy.

        The encoder stays in single precision, so that all precisions share one cache of encoded maps. Outputs are in
        single precision always.

        Raises:
            ValueError: neither "float32" nor "bfloat16"; or single precision of a copy that has lost it.
        """
        if precision not in PRECISIONS:
            raise unknown("precision", precision, PRECISIONS)
        wanted: torch.dtype = getattr(torch, precision)
        if wanted == self.dtype:
            return self
        if wanted == torch.float32:
            raise ValueError("the weights were rounded to bfloat16: open the detector anew for float32")
        twin = copy.deepcopy(self)
        twin._exact = self.digest
        twin.fuser.to(wanted)
        twin.decoder.to(wanted)
        return twin

    @property
    def dtype(self) -> torch.dtype:
        """Of the maps that it fuses, and of fusion and decoder."""
        return next(self.decoder.parameters()).dtype

    @property
    def digest(self) -> str:
        """A fingerprint of all weights and buffers and of the operating threshold."""
        return fingerprint(self, f"{self.fusion} {self.floor} {self.threshold}")

    @property
    def calibration_digest(self) -> str:
        """The `digest` in single precision: similarities and scores of both precisions agree (see docs/speed.md)."""
        return self._exact or self.digest

    @property
    def maps_digest(self) -> str:
        """A fingerprint of the encoder, of the class and of the grid: whatever the fusion, the maps are the same."""
        return fingerprint(self.encoder, f"{type(self).__module__}.{type(self).__qualname__} {BEV} {self.extent}")

    @property
    def _weight(self) -> Tensor:
        return next(self.parameters())
