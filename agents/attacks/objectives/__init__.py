"""What an attack maximises."""

from __future__ import annotations

from agents.attacks.objectives.untargeted import make_objective

__all__ = ["make_objective"]
