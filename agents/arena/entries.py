"""Attacks that enter the arena: scripted ones by name, learned ones by their file, your own by module and class."""

from __future__ import annotations

from typing import Any

from agents.attacks.cached import CachedAttack
from agents.attacks.registry import ATTACKS, ENTRIES, on_timetable
from agents.protocol import Attack, Learned
from defenders.registry import Spec

DEFENCE_UNAWARE = ("noise", "pgd", "bim", "mi_fgsm", "cw")
"""Attacks that know of no defence: each process computes them once for all defenders that they meet in a row."""

_cache: dict[str, CachedAttack] = {}


def make_attack(attack: str | Attack, **options: Any) -> Attack | Learned:
    """An attack that can play in the arena.

    Args:
        attack: one of `agents.names()`; "policy:name=NAME"; or "module:Class" of a class or annotated function of yours
            that builds an `agents.Attack`, or a policy with `options`; each with options or without.
        **options: further options of the attack.

    Returns:
        The attack.

    Raises:
        ValueError: an unknown name or option, a value of the wrong type, or a place that holds no attack: nothing of it
            is called then.
    """
    if isinstance(attack, str):
        spec = Spec.parse(attack)
        if spec.name in DEFENCE_UNAWARE and "target_groups" not in spec.options | options:
            return _cached(attack, options)
    made: Attack | Learned = on_timetable(ENTRIES, attack, **options)
    return made


def _cached(attack: str, options: dict[str, Any]) -> CachedAttack:
    """That attack with the answers it has given so far; the one last made is kept."""
    key = repr((attack, sorted(options.items())))
    if key not in _cache:
        made = CachedAttack(on_timetable(ATTACKS, attack, **options))
        _cache.clear()
        _cache[key] = made
    return _cache[key]
