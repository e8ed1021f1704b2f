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
    from agents.attacks.gradient import Ascent

    of_search = [field.name for field in fields(search)]
    known = [*of_search, *(field.name for field in fields(Ascent) if field.init and field.name != "search")]
    if unknown := sorted(set(knobs) - set(known)):
        raise ValueError(f"unknown knobs {', '.join(unknown)}; known: {', '.join(known)}")
    given = preset | knobs
    how = {name: given.pop(name) for name in of_search if name in given}
    return Ascent(search(**how), **given)


def _pgd(**knobs: Any) -> Attacker:
    from agents.attacks.pgd import Steepest

    return _ascent(Steepest, {}, knobs)


def _bim(**knobs: Any) -> Attacker:
    from agents.attacks.pgd import Steepest

    return _ascent(Steepest, {"random_start": False}, knobs)


def _mi_fgsm(**knobs: Any) -> Attacker:
    from agents.attacks.pgd import Steepest

    return _ascent(Steepest, {"random_start": False, "momentum": 1.0}, knobs)


def _cw(**knobs: Any) -> Attacker:
    from agents.attacks.carlini_wagner import CarliniWagner

    return _ascent(CarliniWagner, {"random_start": False}, knobs)


TIMETABLE = ("every", "start", "duty")

_ATTACKERS: dict[str, Callable[..., Attacker] | str] = {
    "none": "agents.attacks.noise.Silence",
    "noise": "agents.attacks.noise.Noise",
    "random": "agents.attacks.random_action.Chance",
    "pgd": _pgd,
    "bim": _bim,
    "mi_fgsm": _mi_fgsm,
    "cw": _cw,
    "eot": "agents.attacks.adaptive.eot.Eot",
    "in_loop": "agents.attacks.adaptive.threshold_aware.InLoop",
    "ramp": "agents.attacks.adaptive.ramp.ramp",
    "poison": "agents.attacks.adaptive.poison.poison",
    "framing": "agents.attacks.adaptive.framing.Framing",
    "blind": "agents.attacks.adaptive.blind_area.blind",
    "sacrifice": "agents.attacks.adaptive.sacrifice.sacrifice",
}
"""Makers, or where they are: an attacker's file is read when it is asked for."""


def names() -> tuple[str, ...]:
    """The attackers `make` knows."""
    return tuple(_ATTACKERS)


def make(attacker: str | Attacker, **knobs: Any) -> Attacker:
    """The attacker of that name, with its knobs; an attacker object is handed back as it is.

    A name is one of `names()`, or says where to import a class or function of yours: "module:Class", or
    "package.module.Class". Any attacker takes a timetable besides its own knobs: `every`, `start` and `duty`, see
    `agents.attacks.timed`.

    Raises ValueError for an unknown name, for knobs the attacker has not, and for knobs beside an object.
    """
    if not isinstance(attacker, str):
        if knobs:
            raise ValueError(f"knobs go with a name, not with an attacker object; got {sorted(knobs)}")
        return attacker
    factory, timetable = _named(attacker), {knob: knobs.pop(knob) for knob in TIMETABLE if knob in knobs}
    try:
        return _timed(factory(**knobs), timetable)
    except TypeError as error:
        raise ValueError(f"cannot build attacker {attacker!r} with {sorted(knobs)}: {error}") from error


def _timed(attacker: Attacker, timetable: dict[str, Any]) -> Attacker:
    if not timetable:
        return attacker
    from agents.attacks.timed import Timed

    return Timed(attacker, **timetable)


def _named(name: str) -> Callable[..., Attacker]:
    known = _ATTACKERS.get(name, name)
    if not isinstance(known, str):
        return known
    module, _, attribute = known.replace(":", ".").rpartition(".")
    if not module:
        raise ValueError(f"unknown attacker {name!r}; known: {', '.join(_ATTACKERS)}; or module:Class of yours")
    try:
        factory: Callable[..., Attacker] = getattr(import_module(module), attribute)
    except (ImportError, AttributeError) as error:
        raise ValueError(f"no attacker {name!r} ({error}): name one of {', '.join(_ATTACKERS)}, or a class") from error
    return factory


__all__ = ["make", "names"]
