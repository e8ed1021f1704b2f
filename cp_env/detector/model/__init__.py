"""Our own detector: encoder f_E, warp f_T, fusion f_F, decoder f_D."""

from __future__ import annotations

from cp_env.detector.model.base import BaseDetector
from cp_env.detector.model.detector import Detector
from cp_env.detector.model.weights import load_detector, read_detector, save_detector

__all__ = ["BaseDetector", "Detector", "load_detector", "read_detector", "save_detector"]
