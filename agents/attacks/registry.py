"""The family of scripted attacks. A new one enters `ATTACKS`, and the tests of the family then run on it."""

from __future__ import annotations

import inspect
from dataclasses import fields
from importlib import import_module
from typing import Any, get_type_hints

from cp_env.attack import Attack, Learned
from defenders.registry import Registry, Spec, typed_options

TIMETABLE = ("every", "start", "duty")
"""Options that every attack takes besides its own: see `agents.attacks.timed`."""


class GradientFamily:
    """Builds a `GradientAttack` with one optimizer; an option belongs to whichever of the two has a field of its name.

    Args:
        optimizer: where its dataclass is, as "module:Class"; imported when first needed.
        preset: options that differ from the defaults of the two.
    """

    def __init__(self, optimizer: str, **preset: Any) -> None:
        self._place, self._preset = optimizer, preset

    @property
    def _classes(self) -> tuple[type, type]:
        from agents.attacks.gradient import GradientAttack

        module, _, name = self._place.partition(":")
        return getattr(import_module(module), name), GradientAttack

    @property
    def __signature__(self) -> inspect.Signature:
        """The options of both, with their types."""
        parameters = {}
        for cls in self._classes:
            hints = get_type_hints(cls)
            for field in fields(cls):
                if field.init and field.name != "optimizer":
                    parameters[field.name] = inspect.Parameter(
                        field.name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=hints[field.name]
                    )
        return inspect.Signature(list(parameters.values()))

    def __call__(self, **options: Any) -> Attack:
        """The attack."""
        optimizer, attack = self._classes
        given = self._preset | options
        settings = {field.name: given.pop(field.name) for field in fields(optimizer) if field.name in given}
        made: Attack = attack(optimizer(**settings), **given)
        return made


ATTACKS: Registry[Attack] = Registry(
    "attack",
    {
        "none": "agents.attacks.noise:NoPerturbation",
        "noise": "agents.attacks.noise:Noise",
        "random": "agents.attacks.random_action:RandomActions",
        "pgd": GradientFamily("agents.attacks.pgd:ProjectedGradient"),
        "bim": GradientFamily("agents.attacks.pgd:ProjectedGradient", random_start=False),
        "mi_fgsm": GradientFamily("agents.attacks.pgd:ProjectedGradient", random_start=False, momentum=1.0),
        "cw": GradientFamily("agents.attacks.carlini_wagner:CarliniWagner", random_start=False),
        "eot": "agents.attacks.adaptive.eot:Eot",
        "in_loop": "agents.attacks.adaptive.threshold_aware:InLoop",
        "ramp": "agents.attacks.adaptive.ramp:ramp",
        "poison": "agents.attacks.adaptive.poison:poison",
        "framing": "agents.attacks.adaptive.framing:Framing",
        "blind": "agents.attacks.adaptive.blind_area:blind",
        "sacrifice": "agents.attacks.adaptive.sacrifice:sacrifice",
        "nearest_removal": "agents.attacks.leader:nearest_removal",
        "critical_removal": "agents.attacks.leader:critical_removal",
        "phantom_ahead": "agents.attacks.leader:phantom_ahead",
    },
    Attack,
    methods=(("reset", "act"),),
)
"""Constructors, or where they are: an attack's module is imported when it is asked for."""


ENTRIES: Registry[Attack | Learned] = Registry(
    "attack",
    {**ATTACKS.entries, "policy": "agents.learning.policy:load_policy"},
    (Attack, Learned),
    methods=(("reset", "act"), ("options", "__call__")),
)
"""What can be evaluated: scripted attacks, and learned ones as `policy:name=NAME` or `policy:name=FILE.safetensors`."""


def on_timetable(family: Registry[Any], attack: Any, **options: Any) -> Any:
    """A member of the family of attacks, with a timetable around it if its options name one.

    Args:
        family: `ATTACKS` or `ENTRIES`.
        attack: a name or place, with options or without; or an object.
        **options: further options.

    Returns:
        The attack.

    Raises:
        ValueError: what `Registry.make` raises, or a timetable for a policy.
    """
    if not isinstance(attack, str):
        return family.make(attack, **options)
    spec = Spec.parse(attack)
    timetable = {key: value for key, value in [*spec.options.items(), *options.items()] if key in TIMETABLE}
    own = {key: value for key, value in options.items() if key not in TIMETABLE}
    made = family.make(spec.without(TIMETABLE), **own)
    if not timetable:
        return made
    if not isinstance(made, Attack):
        raise ValueError(f"a policy takes no timetable; drop {', '.join(timetable)} from {attack!r}")
    from agents.attacks.timed import Timed

    return Timed(made, **typed_options(Timed, timetable, f"attack {attack!r}", given=("attack",)))
