"""PRBI, Algorithm 1 of "All Vehicles Can Lie", and a corrected stopping rule."""

from __future__ import annotations

from defenders.prbi.defender import Prbi
from defenders.prbi.interpretation import Reading
from defenders.prbi.robust import RobustPrbi

__all__ = ["Prbi", "Reading", "RobustPrbi"]
