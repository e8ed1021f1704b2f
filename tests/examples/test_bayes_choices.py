"""The values that are tried, and how they are set beside the shipped one."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from defenders.bayes import defender, likelihood, posterior
from examples.reproduce import bayes_choices
from examples.reproduce.bayes_choices import CONSTANTS, SHIPPED, Args, Played, give, hashed, table, values


def test_a_value_takes_the_place_of_its_constant_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    for module, attribute, others in CONSTANTS.values():
        shipped = getattr(module, attribute)
        monkeypatch.setattr(module, attribute, shipped)  # puts it back in the end
        assert np.max(shipped) not in others
    give("g₂", 8.0)
    assert posterior.OUTLIER_PRIOR.tolist() == [0.05, 8.0]
    assert (defender.ALARM_PROB, likelihood.OUTLIER_MIX) == (0.05, 0.3)
    give("alarm", 0.1)
    assert defender.ALARM_PROB == 0.1


def test_every_value_is_paired_with_the_shipped_one_by_scene() -> None:
    args = Args(attacks=("pgd", "ramp"), n_scenes=6)

    def played(damage: float, flagged: int) -> dict[str, Played]:
        wobble = [0.01 * i for i in range(6)]
        under = Played([damage + one for one in wobble], [1.0] * 6, [flagged] * 6)
        return {"none": Played([0.0] * 6, [0.5] * 6, [0] * 6), "pgd": under, "ramp": under}

    found = {SHIPPED: played(0.2, 0), "g₂ = 8": played(0.3, 1)}
    console = Console(width=300, record=True)
    console.print(table(found, args))
    shipped, other = (line for line in console.export_text().splitlines() if "│ as" in line or "│ g₂" in line)
    assert "+0.100 [+0.100, +0.100]" in other and "0.000 *" in other
    assert [cell.strip() for cell in other.split("│")][-4:-1] == ["0", "12", "0.50"]
    assert "*" not in shipped


def test_what_was_played_is_read_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    args = Args(scenes="town/calibration", n_scenes=1, attacks=("pgd",), out=tmp_path)
    monkeypatch.setattr(bayes_choices, "measure", lambda *_: pytest.fail("it was played"))
    one = {attack: {"damage": [0.1], "verifications": [0.0], "flagged": [0]} for attack in ("none", "pgd")}
    for name, value in values():
        label = name if value is None else f"{name} = {value:g}"
        (tmp_path / f"{hashed(bayes_choices.about(args) + label)}.json").write_text(json.dumps({"played": one}))
    found = bayes_choices.survey(args)
    assert len(found) == 8 and all(played["pgd"].damage == [0.1] for played in found.values())
