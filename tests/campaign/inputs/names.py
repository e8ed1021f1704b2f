"""Names of plug-ins with their options, at every entrance that takes one; and settings of an environment."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

import agents
import defenders
from agents.arena import make_attack
from agents.learning.policy import load_policy, policy_names
from cp_env.detector.registry import DETECTORS, open_detector
from cp_env.scenes import SOURCES, open_source
from cp_env.settings import DEFAULTS, OPTION_NAMES, Settings
from defenders.registry import Spec
from tests.campaign.inputs.trial import Try
from tests.campaign.values import number, strange, text

PLACES = ("tests.helpers.toy_evaluation:Grumpy", "tests.helpers.toy_scenes:ToySource", "os:abort", "json:loads", "no:X")
OPTIONS = (
    "threshold",
    "steps",
    "name",
    "split",
    "scenes",
    "max_verifications",
    "every",
    "duty",
    "checkpoint",
    "weights",
)
VALUES = ("1", "0.5", "-1", "nan", "inf", "1e400", "true", "none", "calibrated", "(1,2)", "prbi-0", "test", "mean")
GRAMMAR = (":", "=", ",", "?", "&", "/")
WORDS = (
    *defenders.names(),
    *agents.names(),
    *DETECTORS.names(),
    *policy_names(),
    *SOURCES,
    "town/test",
    *PLACES,
    *OPTIONS,
    *VALUES,
    *GRAMMAR,
)
ENTRANCES: tuple[Callable[[str], Any], ...] = (
    Spec.parse,
    defenders.make,
    agents.make,
    make_attack,
    open_source,
    load_policy,
    open_detector,
)


def names(folder: Path) -> Try:
    """Texts of the grammar's words and signs, and of anything else."""
    del folder

    def one(rng: Random) -> bool:
        entrance, given = rng.choice(ENTRANCES), text(rng, WORDS)
        if entrance in (open_detector, make_attack) and rng.random() < 0.9:  # these two do much when they take one
            entrance = Spec.parse
        entrance(given)
        return True

    return one


def objects(folder: Path) -> Try:
    """What is no text and no member of the family, and options that are strange, at entrances that take both."""
    del folder

    def one(rng: Random) -> bool:
        make = rng.choice([defenders.make, agents.make])
        if rng.random() < 0.5:
            make(strange(rng))
        else:
            name = rng.choice([*(defenders.names() if make is defenders.make else agents.names()), "nobody"])
            options = {rng.choice(OPTIONS): rng.choice([strange, number])(rng) for _ in range(rng.randint(1, 2))}
            make(name, **options)
        return True

    return one


NAMED = [name for name in DEFAULTS if name in Settings.__dataclass_fields__]


def settings(folder: Path) -> Try:
    """Settings of which some are other numbers, or strange."""
    del folder

    def one(rng: Random) -> bool:
        Settings.of({name: value(rng, name) for name in rng.sample([*NAMED, "n_vehicels"], rng.randint(1, 4))})
        return True

    return one


def value(rng: Random, name: str) -> Any:
    """A value of that option: of its kind, a number, or strange."""
    kind = rng.random()
    if kind < 0.35:
        return DEFAULTS.get(name)
    if kind < 0.65:
        return number(rng)
    if kind < 0.75:
        return text(rng, [name, *OPTION_NAMES, "linf", "l2", "mean", "black-box"])
    if kind < 0.8:
        return [rng.randint(-1, 6) for _ in range(rng.randint(0, 4))]
    return strange(rng)
