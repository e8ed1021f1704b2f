"""The arena: every defender against every attacker, and what is left in the worst case.

    cp-arena --defenders none prbi mine:Halves --attackers pgd policy:name=prbi-0 mine:Whisper:level=0.5 --ks 2 1 3 4

The machinery (plan, play, figures, report) is `cp_env.evaluation`; here is who enters, and the command.
"""

from __future__ import annotations

from agents.arena.conditions import Conditions
from agents.arena.entries import make_attacker
from agents.arena.progress import Bars

__all__ = ["Bars", "Conditions", "make_attacker"]
