"""The table of the adaptive attacks: what is played, and its rows."""

from __future__ import annotations

import pytest

import agents
import defenders
from agents.attacks.cached import CachedAttack
from cp_env.evaluation import Run
from defenders.registry import Spec
from examples.reproduce import adaptive_attacks as program
from tests.helpers.toy_evaluation import record

ARGS = program.Args(defenders=("prbi",), frames=3)


def test_every_spec_can_be_made_and_every_adaptive_attack_plays() -> None:
    specs = [*program.COMMON, *program.THRESHOLD_AWARE.values(), program.FIRST]
    assert {"eot", "in_loop", "ramp", "poison", "framing", "blind", "sacrifice"} <= {
        Spec.parse(spec).name for spec in specs
    }
    for spec in specs:
        agents.make(spec)
    for spec in program.THRESHOLD_AWARE:
        defenders.make(spec)


def test_only_an_attack_that_knows_of_no_defence_is_cached() -> None:
    assert isinstance(program.make_attack("pgd", steps=3), CachedAttack)
    assert program.make_attack("pgd", steps=3) is program.make_attack("pgd", steps=3)
    assert not isinstance(program.make_attack("framing"), CachedAttack)


def test_the_worst_attack_does_most_damage_in_frames_that_could_be_attacked() -> None:
    graced = record(
        "a",
        "11",
        2,
        damage=(0.0, 0.8, 0.8),
        similarity=(1.0, 0.5, 0.7),
        grace_frames=1,
        attackers=(1, 2),
        suspects=(1, 3),
    )
    early = record(
        "a", "11", 2, damage=(0.7, 0.7, 0.7), similarity=(1.0, 0.9, 0.9), grace_frames=0, attackers=(1, 2), suspects=()
    )
    calm = record(
        "a",
        "11",
        2,
        damage=(0.0, 0.1, 0.1),
        similarity=(1.0, 0.9, 0.9),
        grace_frames=1,
        attackers=(1, 2),
        suspects=(1, 2),
    )
    lines = [
        program.Line("prbi", attack, (one, one))
        for attack, one in (("pgd", calm), ("poison", early), ("framing", graced))
    ]
    rows = program.table(lines, ARGS)
    assert rows[-1] == "* prbi: framing, 0.80 a frame; pgd 0.10"
    cells = [cell.strip() for cell in rows[4].split("|")[1:-1]]
    assert cells[:5] == ["prbi", "framing", "0.53 [0.08, 0.93]", "+0.47 [+0.47, +0.47]", "0.60"]
    assert [cell.split()[0] for cell in cells[-2:]] == ["0.50", "0.33"]
    assert rows[2].split("|")[4].strip() == "", "the first is compared with nothing"


@pytest.mark.parametrize("n", [1, 3])
def test_scenes_are_spread_over_the_source(n: int) -> None:
    assert len(set(program.chosen(program.Args(n_scenes=n)))) == n


def test_the_scenes_of_all_runs_make_one_line() -> None:
    """Three scenes in runs of two: one line of three records, whose order is that of the runs."""
    options = {"damage": (0.0, 0.5), "similarity": (1.0, 0.5), "grace_frames": 1, "attackers": (1,), "suspects": ()}
    scenes = [record(name, "11", 2, **options) for name in "abc"]
    runs = [Run("prbi", "pgd", 1, 0, names) for names in (("a", "b"), ("c",))]
    other = Run("prbi", "bim", 1, 0, ("a", "b"))
    found = program.pooled({runs[0]: scenes[:2], other: scenes[:2], runs[1]: scenes[2:]})
    assert [(line.attack, len(line.records)) for line in found] == [("pgd", 3), ("bim", 2)]
    assert [one.scene for one in found[0].records] == ["a", "b", "c"]


def test_an_attack_on_verdicts_is_not_played_where_none_lasts() -> None:
    for defender in ("robosac", "pasac:score=similarity"):
        assert {"framing", "sacrifice"}.isdisjoint(
            Spec.parse(attack).name for attack in program.against(defender, program.COMMON)
        )
    assert program.against("prbi", program.COMMON) == (*program.COMMON, program.THRESHOLD_AWARE["prbi"])
    assert program.against("mine:Own", ("pgd",)) == ("pgd",)
