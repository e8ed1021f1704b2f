"""Defenders: minds without eyes. They ask for views of groups of vehicles and say whom to fuse.

>>> defender = make("prbi", epsilon=0.4)
>>> names()
('prbi', 'none', 'ego_only', 'oracle', 'pasac', 'robosac', 'bayes')
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any

from defenders.baselines import EgoOnly, NoDefence, Oracle
from defenders.bayes.defender import Bayes
from defenders.pasac import Pasac
from defenders.prbi.defender import Prbi
from defenders.prbi.interpretation import Reading
from defenders.protocol import Defender, Frame, Inspection, Query, QueryError, Verdict, View
from defenders.robosac import Robosac

__all__ = [
    "Bayes",
    "Defender",
    "EgoOnly",
    "Frame",
    "Inspection",
    "NoDefence",
    "Oracle",
    "Pasac",
    "Prbi",
    "Query",
    "QueryError",
    "Reading",
    "Robosac",
    "Verdict",
    "View",
    "make",
    "names",
]

REGISTRY: dict[str, Callable[..., Defender]] = {
    "prbi": Prbi,
    "none": NoDefence,
    "ego_only": EgoOnly,
    "oracle": Oracle,
    "pasac": Pasac,
    "robosac": Robosac,
    "bayes": Bayes,
}


def names() -> tuple[str, ...]:
    """The defenders that `make` knows by name."""
    return tuple(REGISTRY)


def make(defender: str | Defender | Callable[..., Defender], **knobs: Any) -> Defender:
    """A defender from its name or from a class or function that builds one, with its knobs; or the object itself.

    A name is one of `names()`, or says where to import a class or function of yours: "module:Class", or
    "package.module.Class".

    Raises ValueError for an unknown name, for knobs the defender has not, and for knobs beside a finished object.
    """
    if isinstance(defender, Defender):
        if knobs:
            raise ValueError(f"a finished defender takes no knobs, got {sorted(knobs)}; pass its class or its name")
        return defender
    factory = _named(defender) if isinstance(defender, str) else defender
    if not callable(factory):
        raise ValueError(f"a defender is a name, a Defender, or what builds one; got {type(defender).__name__}")
    try:
        made = factory(**knobs)
    except TypeError as error:
        raise ValueError(f"cannot build defender {defender!r} with {sorted(knobs)}: {error}") from error
    if not isinstance(made, Defender):
        raise ValueError(f"{defender!r} built a {type(made).__name__}; it must build a defenders.Defender")
    return made


def _named(name: str) -> Callable[..., Defender]:
    if name in REGISTRY:
        return REGISTRY[name]
    module, _, attribute = name.replace(":", ".").rpartition(".")
    if not module:
        raise ValueError(f"unknown defender {name!r}; known are {', '.join(names())}, or module:Class of yours")
    try:
        factory: Callable[..., Defender] = getattr(import_module(module), attribute)
    except (ImportError, AttributeError) as error:
        raise ValueError(
            f"no defender {name!r} ({error}): name one of {', '.join(names())}, or a class that can be imported"
        ) from error
    return factory
