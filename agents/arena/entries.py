"""Who enters: attackers by name, learned ones by their file, and outsiders by where their class is."""

from __future__ import annotations

from typing import Any

import agents
from agents.policy import load_policy
from cp_env.evaluation import Attacker, Learned
from cp_env.evaluation.cells import outsider

POLICY = "policy"
"""The name of learned attackers; the knob `name` says which: one that ships, or a `.safetensors` file."""


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
        made: Any = load_policy(**knobs) if name == POLICY else agents.make(name, **knobs)
    except TypeError as error:
        raise ValueError(f"cannot build attacker {name!r} with {sorted(knobs)}: {error}") from error
    if not isinstance(made, Attacker | Learned):
        raise ValueError(
            f"{name!r} built a {type(made).__name__}; an attacker has reset and act, a policy has knobs and is called"
        )
    return made
