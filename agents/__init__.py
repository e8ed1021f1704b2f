"""Hands that lie: scripted and learned attackers.

attacker = agents.make("pgd", objective="hide", restarts=3)
attacker.reset(n_worlds, np.random.default_rng(0))
delta = attacker.act(world.situation())
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from agents.protocol import Attacker


def _ascent(search: type, preset: dict[str, Any], knobs: dict[str, Any]) -> Attacker:
    """An `Ascent` by that search; a knob belongs to whichever of the two has a field of its name."""
    from agents.ascent import Ascent

    of_search = [field.name for field in fields(search)]
    known = [*of_search, *(field.name for field in fields(Ascent) if field.init and field.name != "search")]
    if unknown := sorted(set(knobs) - set(known)):
        raise ValueError(f"unknown knobs {', '.join(unknown)}; known: {', '.join(known)}")
    given = preset | knobs
    how = {name: given.pop(name) for name in of_search if name in given}
    return Ascent(search(**how), **given)


def _pgd(**knobs: Any) -> Attacker:
    from agents.steepest import Steepest

    return _ascent(Steepest, {}, knobs)


def _bim(**knobs: Any) -> Attacker:
    from agents.steepest import Steepest

    return _ascent(Steepest, {"random_start": False}, knobs)


def _mi_fgsm(**knobs: Any) -> Attacker:
    from agents.steepest import Steepest

    return _ascent(Steepest, {"random_start": False, "momentum": 1.0}, knobs)


def _cw(**knobs: Any) -> Attacker:
    from agents.carlini_wagner import CarliniWagner

    return _ascent(CarliniWagner, {"random_start": False}, knobs)


def _noise(**knobs: Any) -> Attacker:
    from agents.noise import Noise

    return Noise(**knobs)


def _random(**knobs: Any) -> Attacker:
    from agents.chance import Chance

    return Chance(**knobs)


def _none(**knobs: Any) -> Attacker:
    from agents.noise import Silence

    return Silence(**knobs)


_ATTACKERS: dict[str, Callable[..., Attacker]] = {
    "none": _none,
    "noise": _noise,
    "random": _random,
    "pgd": _pgd,
    "bim": _bim,
    "mi_fgsm": _mi_fgsm,
    "cw": _cw,
}


def names() -> tuple[str, ...]:
    """The attackers `make` knows."""
    return tuple(_ATTACKERS)


def make(attacker: str | Attacker, **knobs: Any) -> Attacker:
    """The attacker of that name, with its knobs; an attacker object is handed back as it is.

    A name is one of `names()`, or says where to import a class or function of yours: "module:Class", or
    "package.module.Class".

    Raises ValueError for an unknown name, for knobs the attacker has not, and for knobs beside an object.
    """
    if not isinstance(attacker, str):
        if knobs:
            raise ValueError(f"knobs go with a name, not with an attacker object; got {sorted(knobs)}")
        return attacker
    factory = _named(attacker)
    try:
        return factory(**knobs)
    except TypeError as error:
        raise ValueError(f"cannot build attacker {attacker!r} with {sorted(knobs)}: {error}") from error


def _named(name: str) -> Callable[..., Attacker]:
    if name in _ATTACKERS:
        return _ATTACKERS[name]
    module, _, attribute = name.replace(":", ".").rpartition(".")
    if not module:
        known = ", ".join(_ATTACKERS)
        raise ValueError(f"unknown attacker {name!r}; known: {known}; or module:Class of yours")
    try:
        factory: Callable[..., Attacker] = getattr(import_module(module), attribute)
    except (ImportError, AttributeError) as error:
        raise ValueError(f"no attacker {name!r} ({error}): name one of {', '.join(_ATTACKERS)}, or a class") from error
    return factory


__all__ = ["make", "names"]
