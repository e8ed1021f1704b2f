"""A posterior over sets of attackers, and the verifications that say most about it."""

from __future__ import annotations

from defenders.bayes.defender import Bayes

__all__ = ["Bayes"]
