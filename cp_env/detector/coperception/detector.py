"""coperception's detector behind our protocol: maps are encoded once, only the ego is decoded."""

from __future__ import annotations

import copy
from collections import OrderedDict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Int, Shaped, UInt8
from torch import Tensor, nn

from cp_env.detector.coperception import fusion, grid, heads
from cp_env.detector.coperception.backbone import CHANNELS, Decoder, Encoder, Skips
from cp_env.detector.coperception.checkpoint import FUSIONS, Weights, read
from cp_env.detector.coperception.heads import Anchored, Heads
from cp_env.detector.model import warp
from cp_env.detector.model.decoder import Dense
from cp_env.detector.model.fingerprint import fingerprint, refuse_empty
from cp_env.geometry.boxes import pairwise_iou
from cp_env.types import Detections, Sweep

CHUNK = 4
"""Sweeps or views computed together: the widest layer takes 17 MB of each."""

REMEMBERED = 16
"""Frames whose `Skips` are kept, 16 MB each: a frame is perceived many times."""

CANDIDATES = 4096
MOST_BOXES = 200
NMS_IOU = 0.01
OWN_RADIUS = 1.5  # m; nothing else's centre can be this close to the ego's
RESAMPLING = {"affine": (-2, -1), "rotate-translate": (-1,)}
"""How coperception warps, and along which axes its maps are mirrored, against ours, while it fuses them.

"affine": in one go, as its code does since it also mirrors rows; "rotate-translate": in two, as its code did before.
The geometry is the same; the second samples twice and loses what the turn carries out of the map.
"""


class CoperceptionDetector(nn.Module):
    """The frozen network of a checkpoint. See `load_checkpoint`.

    A view is decoded with layers of the ego's own sweep that are never sent, nor can be attacked: `ego_context`
    packs what the ego keeps of a sweep, and `with_ego_context(ego_context)` is this detector bound to those egos, which
    can `perceive`.
    """

    channels = CHANNELS
    size = 32
    extent = grid.EXTENT
    map_size = heads.MAP_SIZE
    floor = 0.05
    threshold = 0.7

    def __init__(
        self, weights: Weights, fusion_name: str, rounds: int, resampling: str, *, all_boxes: bool = False
    ) -> None:
        super().__init__()
        single = "stpn" in weights.prefixes and "u_encoder" not in weights.prefixes
        self.fusion, self.resampling, self.rounds, self.all_boxes = fusion_name, resampling, rounds, all_boxes
        self.encoder = Encoder(weights, "stpn" if single else "u_encoder")
        if fusion_name == "v2vnet" and len(self.encoder.narrow):
            raise ValueError(
                f"{weights.source} does not fit: its V2VNet sends compressed maps, which coperception compresses anew "
                "in every round; only the uncompressed one (compress_level 0) can be read"
            )
        self.fuser = fusion.make(fusion_name, weights, rounds, RESAMPLING[resampling])
        self.decoder = Decoder(weights, "stpn" if single else "decoder")
        self.heads = Heads(weights)
        self._ego_context: UInt8[Tensor, "E 13 256 32"] | None = None
        self._skips: OrderedDict[tuple[str, bytes], Skips] = OrderedDict()
        self.eval().requires_grad_(False)

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_skips": OrderedDict()}  # made again when asked for

    def encode(self, sweeps: Sequence[Sweep]) -> Float[Tensor, "B C H W"]:
        """The shared map of each sweep, in its own sensor's grid frame and in our layout."""
        return self.encode_grids(grid.rasterise(sweeps, self.device))

    def encode_grids(self, occupancy: Shaped[Tensor, "B 13 256 256"]) -> Float[Tensor, "B C H W"]:
        """The shared map of each grid (`coperception.grid`), in our layout: columns grow with x."""
        parts = [self.encoder.shared(part.to(self._weight)) for part in occupancy.split(CHUNK)]
        return torch.cat(parts).flip(-1) if parts else self._weight.new_zeros((0, CHANNELS, self.size, self.size))

    def ego_context(self, sweeps: Sequence[Sweep]) -> UInt8[Tensor, "B 13 256 32"]:
        """The ego context of each sweep: its voxels, eight to a byte."""
        return grid.pack(grid.rasterise(sweeps))

    def with_ego_context(self, ego_context: UInt8[Tensor, "E 13 256 32"]) -> CoperceptionDetector:
        """This detector (the same weights) bound to the ego context of E worlds."""
        bound = copy.copy(self)
        bound._ego_context, bound._skips = ego_context, self._skips
        return bound

    def warp(self, maps: Float[Tensor, "*n C H W"], ego_T_sender: Float[Tensor, "*n 3"]) -> Float[Tensor, "*n C H W"]:
        """Sender maps in the ego's frame; zeros where the sender's map does not reach. Linear in `maps`."""
        if self.resampling == "affine" or not bool(ego_T_sender[..., 2].any()):
            return warp.warp(maps, ego_T_sender, self.extent)
        turn, shift = ego_T_sender.clone(), ego_T_sender.clone()
        turn[..., :2], shift[..., 2] = 0, 0
        return warp.warp(warp.warp(maps, turn, self.extent), shift, self.extent)

    def coverage(self, ego_T_sender: Float[Tensor, "*n 3"]) -> Float[Tensor, "*n H W"]:
        """1 in those cells of the ego's map that the sender's map covers, else 0. coperception's fusions do not ask."""
        return warp.coverage(ego_T_sender, self.size, self.extent)

    def perceive(
        self,
        received: Float[Tensor, "E N C H W"],
        coverage: Float[Tensor, "E N H W"],
        world: Int[Tensor, " B"],
        groups: Bool[Tensor, "B N"],
    ) -> Anchored:
        """What the ego's decoder makes of each row (world, members). Raises ValueError for an empty group."""
        del coverage
        refuse_empty(groups)
        views = [self._view(received, w, g) for w, g in zip(world.split(CHUNK), groups.split(CHUNK), strict=True)]
        return Anchored(*(torch.cat(parts) for parts in zip(*views, strict=True)))

    def raw(
        self, received: Float[Tensor, "E N C H W"], world: Int[Tensor, " B"], groups: Bool[Tensor, "B N"]
    ) -> tuple[Float[Tensor, "B 6 256 256"], Float[Tensor, "B 6 6 256 256"]]:
        """The heads' own output, log-odds and codes of every anchor, in coperception's layout (see `heads.Heads`)."""
        worlds = world.tolist()
        skips = [self._skip(e) for e in (worlds if len(set(worlds)) > 1 else worlds[:1])]  # one row is broadcast
        stacked = Skips(*(torch.cat(parts) for parts in zip(*(vars(s).values() for s in skips), strict=True)))
        scores, codes = self.heads(self.decoder(self.fuser(received, world, groups).flip(-1), stacked))
        return scores, codes

    def detect(self, dense: Dense, own: Float[np.ndarray, "B 2"] | None = None) -> list[Detections]:
        """The boxes of each view, best first, after non-maximum suppression at IoU 0.01, without the ego itself.

        Those above 0.7 are coperception's own, less the ego (`own` is where it stands in its grid frame, at the origin
        by default) and boxes whose centre is out of range; with `all_boxes`, less nothing.
        """
        assert isinstance(dense, Anchored)  # what `perceive` gives: `Dense` alone does not hold all anchors
        scores, boxes = (part.cpu().double().numpy() for part in (dense.scores_found, dense.boxes_found))
        places = np.zeros((len(scores), 2)) if own is None else own
        return [self._boxes(*view) for view in zip(boxes, scores, places, strict=True)]

    @property
    def device(self) -> torch.device:
        """Where the weights are."""
        return self._weight.device

    @property
    def digest(self) -> str:
        """A fingerprint of the weights and of all that changes what they say."""
        what = f"{self.fusion} {self.rounds} {self.resampling} {self.floor} {self.threshold}"
        return fingerprint(self, what + (" all boxes" if self.all_boxes else ""))

    @property
    def maps_digest(self) -> str:
        """A fingerprint of the encoder, the class and the way of warping: the fusions of one encoder share it."""
        return fingerprint(self.encoder, f"{type(self).__module__}.{type(self).__qualname__} {self.resampling}")

    def _view(
        self, received: Float[Tensor, "E N C H W"], world: Int[Tensor, " B"], groups: Bool[Tensor, "B N"]
    ) -> tuple[Tensor, ...]:
        scores, codes = self.raw(received, world, groups)
        return *heads.reduce(scores, codes), *heads.best_anchors(scores, codes, self.floor, CANDIDATES)

    def _skip(self, world: int) -> Skips:
        """The ego's own part of its decoder's sums, made once a frame."""
        if self._ego_context is None:
            raise ValueError(
                "this detector decodes with layers of the ego's own sweep: perceive with "
                "detector.with_ego_context(ego_context), where ego_context = detector.ego_context(sweeps) of the egos"
            )
        device = self.device
        key = str(device), self._ego_context[world].cpu().numpy().tobytes()
        if key not in self._skips:
            with torch.inference_mode(False), torch.no_grad():  # an attack may differentiate through what meets it
                voxels = grid.unpack(self._ego_context[world].to(device, copy=True))[None]
                self._skips[key] = self.decoder.skips(self.encoder(voxels.to(self._weight)))
        self._skips.move_to_end(key)
        while len(self._skips) > REMEMBERED:
            self._skips.popitem(last=False)
        return self._skips[key]

    def _boxes(
        self, boxes: Float[np.ndarray, "K 5"], scores: Float[np.ndarray, " K"], own: Float[np.ndarray, " 2"]
    ) -> Detections:
        kept: list[int] = []
        rows = np.flatnonzero(scores > 0)
        while len(rows) and len(kept) < MOST_BOXES:  # best first; the overlaps of few boxes are few
            best, rows = rows[0], rows[1:]
            kept.append(int(best))
            rows = rows[pairwise_iou(boxes[best][None], boxes[rows])[0] <= NMS_IOU]
        boxes, scores = boxes[kept], scores[kept]
        if self.all_boxes:
            return Detections(boxes.astype(np.float32), scores.astype(np.float32))
        inside = (np.abs(boxes[:, :2]) <= self.extent).all(axis=1)
        valid = inside & (np.linalg.norm(boxes[:, :2] - own, axis=1) > OWN_RADIUS)
        return Detections(boxes[valid].astype(np.float32), scores[valid].astype(np.float32))

    @property
    def _weight(self) -> Tensor:
        return self.heads.first.weight


def load_checkpoint(
    path: str | Path,
    *,
    fusion: str = "mean",
    rounds: int = 3,
    resampling: str = "affine",
    all_boxes: bool = False,
    device: str = "cpu",
) -> CoperceptionDetector:
    """The detector of one of coperception's checkpoints, frozen.

    Args:
        path: a file that coperception saved: a dictionary with `model_state_dict`. Nothing in it is run.
        fusion: "mean", "max", "sum" (which are the same in a checkpoint), "v2vnet" or "disconet".
        rounds: V2VNet's rounds of messages. Versions of its code that begin every round anew do what one round does.
        resampling: "affine" or "rotate-translate": how its code warps (see `RESAMPLING`).
        all_boxes: keep the ego's own box and those beyond ±32 m, as their code does. Score such a detector with
            `cp_env.detector.coperception.truth.their_truth`.
        device: where the detector runs, as torch spells it.

    Raises:
        ValueError: an unknown name; the file is missing or cannot be read without running code; its parts or shapes are
            not those of the model, in which case the message says which.
    """
    for what, value, known in (("fusion", fusion, FUSIONS), ("resampling", resampling, tuple(RESAMPLING))):
        if value not in known:
            raise ValueError(f"unknown {what} {value!r}: choose one of {', '.join(known)}")
    if rounds < 1:
        raise ValueError(f"rounds must be at least 1, not {rounds}")
    weights = read(path)
    weights.check_parts(fusion)
    return CoperceptionDetector(weights, fusion, rounds, resampling, all_boxes=all_boxes).to(device)
