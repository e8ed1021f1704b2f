"""Hands that lie: scripted and learned attackers.

attacker = agents.make("pgd")
attacker.reset(n_worlds, np.random.default_rng(0))
delta = attacker.act(world.situation())
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from agents.protocol import Attacker


def _ascent(**knobs: Any) -> Attacker:
    from agents.ascent import Ascent

    return Ascent(**knobs)


def _pgd(**knobs: Any) -> Attacker:
    return _ascent(random_start=True, **knobs)


def _bim(**knobs: Any) -> Attacker:
    return _ascent(random_start=False, **knobs)


def _cw(**knobs: Any) -> Attacker:
    from agents.carlini_wagner import CarliniWagner

    return CarliniWagner(**knobs)


def _noise(**knobs: Any) -> Attacker:
    from agents.ascent import Noise

    return Noise(**knobs)


def _none(**knobs: Any) -> Attacker:
    from agents.ascent import Silence

    return Silence(**knobs)


_ATTACKERS: dict[str, Callable[..., Attacker]] = {"none": _none, "noise": _noise, "pgd": _pgd, "bim": _bim, "cw": _cw}


def names() -> tuple[str, ...]:
    """The attackers `make` knows."""
    return tuple(_ATTACKERS)


def make(attacker: str | Attacker, **knobs: Any) -> Attacker:
    """The attacker of that name, with its knobs; an attacker object is handed back as it is."""
    if not isinstance(attacker, str):
        if knobs:
            raise ValueError(f"knobs go with a name, not with an attacker object; got {sorted(knobs)}")
        return attacker
    if attacker not in _ATTACKERS:
        raise ValueError(f"unknown attacker {attacker!r}; known: {', '.join(_ATTACKERS)}")
    return _ATTACKERS[attacker](**knobs)


__all__ = ["make", "names"]
