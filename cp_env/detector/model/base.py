"""The base class of detectors: maps are warped and boxes found as our own detector does."""

from __future__ import annotations

from itertools import chain, pairwise

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from cp_env.detector.model import warp
from cp_env.detector.model.decoder import Dense, peaks
from cp_env.detector.model.fingerprint import fingerprint
from cp_env.geometry.boxes import nms_batch
from cp_env.geometry.device_boxes import suppressed
from cp_env.types import Detections

MOST_BOXES = 80
PRECISIONS = ("float32", "bfloat16")
"""What maps, fusion and decoder may be computed in; a detector knows the first, and others if it says so."""
OWN_RADIUS = 1.5  # m; nothing else's centre can be this close to the ego's
NMS_IOU = 0.15  # two vehicles cannot overlap, two boxes estimated of neighbours may a little


def moves_as_ours(detector: object) -> bool:
    """Whether a detector's `warp` is the base class's own, so that maps may be moved straight to their place."""
    return getattr(getattr(detector, "warp", None), "__func__", None) is BaseDetector.warp


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
        """See `cp_env.detector.model.warp`: bilinear; whole cells copied, zeros outside the sender's map."""
        return warp.warp(maps, ego_T_sender, self.extent)

    def coverage(self, ego_T_sender: Float[Tensor, "*n 3"]) -> Float[Tensor, "*n H W"]:
        """1 in those cells of the ego's map that the sender's map covers, else 0."""
        return warp.coverage(ego_T_sender, self.size, self.extent)

    def detect(self, dense: Dense, own: Float[np.ndarray, "B 2"] | None = None) -> list[Detections]:
        """The boxes of each view, best first, down to `floor`, without overlaps and without the ego itself.

        `own` is where the ego stands in its grid frame in each view, m; at the origin by default.
        """
        found = peaks(dense, self.floor, self.extent, MOST_BOXES)
        if found[0].device.type != "cpu":
            return self._detected(*found, own)
        scores, boxes = (array.numpy() for array in found)
        centre = boxes[..., :2]
        apart = np.linalg.norm(centre - (0.0 if own is None else own[:, None]), axis=-1) > OWN_RADIUS
        valid = (scores > 0) & apart & (np.abs(centre) <= self.extent).all(axis=-1)
        boxes, scores, views = boxes[valid], scores[valid], np.nonzero(valid)[0]
        stay = nms_batch(boxes, scores, views, NMS_IOU)
        return _split(boxes[stay], scores[stay], np.bincount(views[stay], minlength=len(dense.logits)))

    def _detected(
        self, scores: Float[Tensor, "B K"], boxes: Float[Tensor, "B K 5"], own: Float[np.ndarray, "B 2"] | None
    ) -> list[Detections]:
        """The same on a device: all views at once, and one transfer of what is left."""
        centre = boxes[..., :2]
        place = torch.zeros(2) if own is None else torch.from_numpy(own)[:, None]
        apart = (centre - place.to(boxes.device)).norm(dim=-1) > OWN_RADIUS
        stays = suppressed(boxes, (scores > 0) & apart & (centre.abs() <= self.extent).all(-1), NMS_IOU)
        return _split(boxes[stays].cpu().numpy(), scores[stays].cpu().numpy(), stays.sum(1).cpu().numpy())

    def freeze(self) -> BaseDetector:
        """Make this the victim: evaluation mode, no gradients to weights."""
        return self.eval().requires_grad_(False)

    def with_precision(self, precision: str) -> BaseDetector:
        """The same detector with maps, fusion and decoder in that precision: itself in its own.

        Raises:
            ValueError: a precision that the class does not know; this one knows "float32" alone.
        """
        if precision != "float32":
            raise ValueError(f"detector {type(self).__name__} knows no precision but float32, not {precision!r}")
        return self

    @property
    def dtype(self) -> torch.dtype:
        """Of the maps that it fuses."""
        return torch.float32

    @property
    def calibration_digest(self) -> str:
        """What defenders' calibrations for this detector are kept under."""
        return self.digest

    @property
    def device(self) -> torch.device:
        """Where its weights and buffers are; the CPU if it has none."""
        first = next(chain(self.parameters(), self.buffers()), None)
        return torch.device("cpu") if first is None else first.device

    @property
    def digest(self) -> str:
        """A fingerprint of the class's name, the thresholds, and all weights and buffers."""
        name = f"{type(self).__module__}.{type(self).__qualname__}"
        return fingerprint(self, f"{name} {self.size} {self.extent} {self.floor} {self.threshold}")


def _split(
    boxes: Float[np.ndarray, "L 5"], scores: Float[np.ndarray, " L"], counts: Int[np.ndarray, " B"]
) -> list[Detections]:
    """Boxes of all views, one view after the other, as one `Detections` a view."""
    ends = np.concatenate([[0], np.cumsum(counts)])
    return [Detections(boxes[a:b], scores[a:b]) for a, b in pairwise(ends.tolist())]
