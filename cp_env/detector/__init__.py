"""f_E, f_T, f_F and f_D: from sweeps to shared maps, and from a group's maps to oriented boxes."""

from __future__ import annotations

from cp_env.detector.model.decoder import Dense
from cp_env.detector.model.detector import Detector
from cp_env.detector.model.weights import load_detector

__all__ = ["Dense", "Detector", "load_detector"]
