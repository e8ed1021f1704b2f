"""Who enters: attackers by name, learned ones by their file, and outsiders by where their class is."""

from __future__ import annotations

from typing import Any

import agents
from agents.attacks.cached import Remembered
from agents.learning.policy import load_policy
from cp_env.evaluation import Attacker, Learned
from cp_env.evaluation.plan.runs import outsider

POLICY = "policy"
"""The name of learned attackers; the knob `name` says which: one that ships, or a `.safetensors` file."""

UNTOLD = ("noise", "pgd", "bim", "mi_fgsm", "cw")
"""Attacks that know of no defence: each process computes them once for all defenders that they meet in a row."""

_held: dict[str, Remembered] = {}


def make_attacker(name: str, /, **knobs: Any) -> Attacker | Learned:
    """An attacker that can play in the arena.

    Args:
        name: one of `agents.names()`; "policy", with `name=` in its knobs; "module:Class" (or "package.module.Class")
            of a class or function of yours that builds an `agents.protocol.Attacker`, or a policy with `knobs`.
        knobs: of the attacker.

    Raises:
        ValueError: an unknown name, a class that cannot be imported, knobs it has not, or what is no attacker.
    """
    if name not in (POLICY, *agents.names()) and not outsider(name):
        raise ValueError(
            f"unknown attacker {name!r}; known: {', '.join(agents.names())}, {POLICY}:name=…, or module:Class of yours"
        )
    try:
        if name == POLICY:
            made: Any = load_policy(**knobs)
        elif name in UNTOLD and "audience" not in knobs:
            made = _remembered(name, knobs)
        else:
            made = agents.make(name, **knobs)
    except TypeError as error:
        raise ValueError(f"cannot build attacker {name!r} with {sorted(knobs)}: {error}") from error
    if not isinstance(made, Attacker | Learned):
        raise ValueError(
            f"{name!r} built a {type(made).__name__}; an attacker has reset and act, a policy has knobs and is called"
        )
    return made


def _remembered(name: str, knobs: dict[str, Any]) -> Remembered:
    """That attacker with what it has answered so far; the one last made is kept."""
    key = repr((name, sorted(knobs.items())))
    if key not in _held:
        made = Remembered(agents.make(name, **knobs))
        _held.clear()
        _held[key] = made
    return _held[key]
