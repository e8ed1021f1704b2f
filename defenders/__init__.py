"""Defenders of collaborative perception: they query views of groups of vehicles and decide which vehicles to fuse.

>>> defender = make("prbi:epsilon=0.4")
>>> names()
('prbi', 'robust_prbi', 'none', 'ego_only', 'oracle', 'pasac', 'robosac', 'bayes')
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import TYPE_CHECKING, Any

from defenders.protocol import (
    Defender,
    Frame,
    HasThreshold,
    Informed,
    Inspection,
    Query,
    QueryError,
    Verdict,
    View,
)
from defenders.registry import Registry

if TYPE_CHECKING:
    from defenders.baselines import EgoOnly, NoDefence, Oracle
    from defenders.bayes import Bayes
    from defenders.pasac import Pasac
    from defenders.prbi import Prbi, Reading, RobustPrbi
    from defenders.robosac import Robosac

__all__ = [
    "DEFENDERS",
    "Bayes",
    "Defender",
    "EgoOnly",
    "Frame",
    "HasThreshold",
    "Informed",
    "Inspection",
    "NoDefence",
    "Oracle",
    "Pasac",
    "Prbi",
    "Query",
    "QueryError",
    "Reading",
    "Robosac",
    "RobustPrbi",
    "Verdict",
    "View",
    "make",
    "names",
]

_LAZY = {
    "Bayes": "defenders.bayes",
    "EgoOnly": "defenders.baselines",
    "NoDefence": "defenders.baselines",
    "Oracle": "defenders.baselines",
    "Pasac": "defenders.pasac",
    "Prbi": "defenders.prbi",
    "Reading": "defenders.prbi",
    "RobustPrbi": "defenders.prbi",
    "Robosac": "defenders.robosac",
}

DEFENDERS: Registry[Defender] = Registry(
    "defender",
    {
        "prbi": "defenders.prbi.defender:Prbi",
        "robust_prbi": "defenders.prbi.robust:RobustPrbi",
        "none": "defenders.baselines:NoDefence",
        "ego_only": "defenders.baselines:EgoOnly",
        "oracle": "defenders.baselines:Oracle",
        "pasac": "defenders.pasac:Pasac",
        "robosac": "defenders.robosac:Robosac",
        "bayes": "defenders.bayes.defender:Bayes",
    },
    Defender,
)
"""The family of defenders. A new one enters here, and the tests of the family then run on it."""


def __getattr__(name: str) -> Any:
    """The defenders' classes, each imported when first asked for."""
    if name in _LAZY:
        return getattr(import_module(_LAZY[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def names() -> tuple[str, ...]:
    """The defenders that `make` knows by name."""
    return DEFENDERS.names()


def make(defender: str | Defender | Callable[..., Defender], **options: Any) -> Defender:
    """Build a defender.

    Args:
        defender: One of `names()`, or "module:Class" of yours, either with options ("bayes:max_verifications=8"); a
            class or function that builds a defender; or a finished defender.
        **options: Further options of the defender.

    Returns:
        The defender. A finished one is returned as it is.

    Raises:
        ValueError: For an unknown name or option (with the nearest known one), a value of the wrong type, options of a
            finished defender, and a place that holds no defender: nothing of it is called then.
    """
    return DEFENDERS.make(defender, **options)
