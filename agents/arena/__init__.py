"""The arena: every defender against every attack, and what is left in the worst case.

    cp-arena --defenders none prbi mine:Halves --attacks pgd policy:name=prbi-0 mine:Whisper:level=0.5 --ks 2 1 3 4

Plan, execution, analysis and report are in `cp_env.evaluation`; the entries and the command line are here.
"""

from __future__ import annotations

from agents.arena.conditions import CommonOptions
from agents.arena.entries import make_attack
from agents.arena.progress import Bars

__all__ = ["Bars", "CommonOptions", "make_attack"]
