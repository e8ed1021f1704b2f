"""Scripted attacks: the search for a perturbation, what it aims at, and when it is sent."""

from __future__ import annotations

from agents.attacks.registry import ATTACKS, ENTRIES

__all__ = ["ATTACKS", "ENTRIES"]
