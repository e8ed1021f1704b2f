"""Similarity thresholds by group size: as published, calibrated, or given."""

from __future__ import annotations

from defenders.thresholds.tables import open_thresholds

__all__ = ["open_thresholds"]
