"""Trained weights: where they are, how they are read and written (safetensors; nothing is unpickled)."""

from __future__ import annotations

from cp_env.detector.detector import Detector


def load_detector(name: str = "mean", device: str = "cpu") -> Detector:
    """The trained detector of that name, frozen."""
    return Detector(fusion=name).to(device).freeze()
