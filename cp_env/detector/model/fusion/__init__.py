"""f_F: the maps of a group's members, warped into the ego's frame, become one. Five ways, one file each or together."""

from __future__ import annotations

from collections.abc import Callable

from cp_env.detector.model.fusion.base import Fusion
from cp_env.detector.model.fusion.disconet import DiscoNet
from cp_env.detector.model.fusion.pooling import Max, Mean, Sum
from cp_env.detector.model.fusion.v2vnet import V2VNet

FUSIONS: dict[str, Callable[[int], Fusion]] = {
    "mean": lambda channels: Mean(),
    "max": lambda channels: Max(),
    "sum": lambda channels: Sum(),
    "v2vnet": V2VNet,
    "disconet": DiscoNet,
}
"""From a name to the fusion of maps with so many channels, its weights random."""

__all__ = ["FUSIONS", "Fusion"]
