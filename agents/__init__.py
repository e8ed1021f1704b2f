"""Attacks on collaborative perception, scripted and learned: what a malicious vehicle adds to the map it sends.

    attack = agents.make("pgd:restarts=3", objective="hide")
    attack.reset(n_worlds, np.random.default_rng(0).spawn(n_worlds))  # one generator a world
    delta = attack.act(world.situation())

Importing this package loads neither torch nor the world.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from agents.learning.policy import load_policy
    from agents.protocol import Attack

__all__ = ["Attack", "load_policy", "make", "names"]

_FOLDERS = {"__pycache__", "arena", "attacks", "calibration", "commands", "learning"}
_OURS = {*_FOLDERS, "__init__.py", "protocol.py", "py.typed", "sb3.py"}

if _strangers := sorted(entry.name for entry in Path(__file__).parent.iterdir() if entry.name not in _OURS):
    raise ImportError(
        f"another package named `agents` is installed in the same folder ({', '.join(_strangers[:3])}): PyPI's "
        "`agents` and `openai-agents` use that name, too. Install cp-env in an environment without them"
    )

_LAZY = {"Attack": "agents.protocol", "load_policy": "agents.learning.policy"}


def __getattr__(name: str) -> Any:
    """What loads torch, when first asked for."""
    if name in _LAZY:
        return getattr(import_module(_LAZY[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def names() -> tuple[str, ...]:
    """Names of the attacks that `make` knows."""
    from agents.attacks.registry import ATTACKS

    return ATTACKS.names()


def make(attack: str | Attack, **options: Any) -> Attack:
    """An attack by name, with its options; an attack object is returned as it is.

    Args:
        attack: one of `names()`, or "module:Class" of yours, either with options ("pgd:steps=30"); or an attack object.
        **options: further options of the attack. Every attack also takes a timetable: `every`, `start` and `duty`, see
            `agents.attacks.timed`.

    Returns:
        The attack.

    Raises:
        ValueError: an unknown name or option (with the nearest known one), a value of the wrong type, options for an
            attack object, or a place that holds no attack: nothing of it is called then.
    """
    from agents.attacks.registry import ATTACKS, on_timetable

    made: Attack = on_timetable(ATTACKS, attack, **options)
    return made
