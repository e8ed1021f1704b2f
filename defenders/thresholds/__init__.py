"""Similarity thresholds that ship, by group size."""

from __future__ import annotations

from defenders.thresholds.tables import open_thresholds

__all__ = ["open_thresholds"]
