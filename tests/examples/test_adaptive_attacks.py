"""The table of the attackers that know the defence: what is played, and how it is told."""

from __future__ import annotations

import pytest

import agents
import defenders
from agents.attacks.cached import Remembered
from cp_env.evaluation.plan.runs import parse
from examples.reproduce import adaptive_attacks as program
from tests.helpers.toy_evaluation import record

ARGS = program.Args(defenders=("prbi",), frames=3)


def test_every_spec_can_be_made_and_every_adaptive_attacker_plays() -> None:
    specs = [*program.COMMON, *program.TOLD.values(), program.FIRST]
    assert {"eot", "in_loop", "ramp", "poison", "framing", "blind", "sacrifice"} <= {parse(spec)[0] for spec in specs}
    for spec in specs:
        name, knobs = parse(spec)
        agents.make(name, **knobs)
    for spec in program.TOLD:
        name, knobs = parse(spec)
        defenders.make(name, **knobs)


def test_only_who_knows_of_no_defence_is_remembered() -> None:
    assert isinstance(program.attacker("pgd", steps=3), Remembered)
    assert program.attacker("pgd", steps=3) is program.attacker("pgd", steps=3)
    assert not isinstance(program.attacker("framing"), Remembered)


def test_the_worst_attacker_is_the_one_of_most_damage_in_frames_that_could_be_attacked() -> None:
    graced = record(
        "a", "11", 2, damage=(0.0, 0.8, 0.8), similarity=(1.0, 0.5, 0.7), grace_frames=1, liars=(1, 2), suspects=(1, 3)
    )
    early = record(
        "a", "11", 2, damage=(0.7, 0.7, 0.7), similarity=(1.0, 0.9, 0.9), grace_frames=0, liars=(1, 2), suspects=()
    )
    calm = record(
        "a", "11", 2, damage=(0.0, 0.1, 0.1), similarity=(1.0, 0.9, 0.9), grace_frames=1, liars=(1, 2), suspects=(1, 2)
    )
    lines = [
        program.Line("prbi", attack, (one, one))
        for attack, one in (("pgd", calm), ("poison", early), ("framing", graced))
    ]
    told = program.table(lines, ARGS)
    assert told[-1] == "* prbi: framing, 0.80 a frame; pgd 0.10"
    assert told[4].startswith("| prbi | framing | 1.6 [1.6, 1.6] | 0.60 |")
    assert told[4].endswith("| 0.50 | 0.33 |")


@pytest.mark.parametrize("n", [1, 3])
def test_scenes_are_spread_over_the_source(n: int) -> None:
    assert len(set(program.chosen(program.Args(n_scenes=n)))) == n
