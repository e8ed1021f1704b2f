"""Calibration of defenders: the similarities that a detector's views have, with and without attacks, and what follows.

Every measurement plays scenes under an instrument: a defender that compares groups and defends nothing.
"""

from __future__ import annotations

from agents.calibration.measure import Plan, measure

__all__ = ["Plan", "measure"]
