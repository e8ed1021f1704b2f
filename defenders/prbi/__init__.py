"""PRBI, Algorithm 1 of "All Vehicles Can Lie", and a corrected stopping rule beside it."""

from __future__ import annotations

from defenders.prbi.defender import Prbi
from defenders.prbi.interpretation import Reading

__all__ = ["Prbi", "Reading"]
