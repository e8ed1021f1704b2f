"""Defenders: minds without eyes. They ask for views of groups of vehicles and say whom to fuse.

>>> defender = make("prbi", epsilon=0.4)
>>> names()
('prbi', 'none', 'ego_only', 'oracle', 'pasac', 'robosac')
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from defenders.bounds import EgoOnly, NoDefence, Oracle
from defenders.pasac import Pasac
from defenders.prbi import Prbi
from defenders.protocol import Defender, Frame, Inspection, Query, QueryError, Verdict, View
from defenders.readings import Reading
from defenders.robosac import Robosac

__all__ = [
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
}


def names() -> tuple[str, ...]:
    """The defenders that `make` knows by name."""
    return tuple(REGISTRY)


def make(defender: str | Defender | Callable[..., Defender], **knobs: Any) -> Defender:
    """A defender from its name or from a class or function that builds one, with its knobs; or the object itself.

    Raises ValueError for an unknown name, for knobs the defender has not, and for knobs beside a finished object.
    """
    if isinstance(defender, Defender):
        if knobs:
            raise ValueError(f"a finished defender takes no knobs, got {sorted(knobs)}; pass its class or its name")
        return defender
    if isinstance(defender, str) and defender not in REGISTRY:
        raise ValueError(f"unknown defender {defender!r}; known are {', '.join(names())}")
    factory = REGISTRY[defender] if isinstance(defender, str) else defender
    if not callable(factory):
        raise ValueError(f"a defender is a name, a Defender, or what builds one; got {type(defender).__name__}")
    try:
        made = factory(**knobs)
    except TypeError as error:
        raise ValueError(f"cannot build defender {defender!r} with {sorted(knobs)}: {error}") from error
    if not isinstance(made, Defender):
        raise ValueError(f"{defender!r} built a {type(made).__name__}; it must build a defenders.Defender")
    return made
