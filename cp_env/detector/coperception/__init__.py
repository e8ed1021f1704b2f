"""The detector of the public coperception code (mean, max, sum, V2VNet and DiscoNet on V2X-Sim), from its checkpoints.

    detector = load_checkpoint("epoch_100.pth", fusion="v2vnet")
    env = cp_env.parallel_env(detector="coperception", checkpoint="epoch_100.pth", fusion="v2vnet")

Layer sequence, shapes, anchors and conventions were read from that code (github.com/coperception/coperception) and are
written here anew. See docs/coperception.md.
"""

from __future__ import annotations

from cp_env.detector.coperception.checkpoint import FUSIONS
from cp_env.detector.coperception.detector import RESAMPLING, CoperceptionDetector, load_checkpoint

__all__ = ["FUSIONS", "RESAMPLING", "CoperceptionDetector", "load_checkpoint"]
