"""The values that are tried, and how they are set beside the shipped one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from cp_env.evaluation import Record
from defenders.bayes import defender, likelihood, posterior
from examples.reproduce import bayes_choices
from examples.reproduce.bayes_choices import CONSTANTS, SHIPPED, Args, Played, give, plan, play, store_of, table, values
from tests.examples.test_defence_tables import record
from tests.helpers.toy_scenes import ToySource


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

    def played(damage: float, suspects: tuple[int, ...]) -> Played:
        def of(scene: int) -> Record:
            here = replace(record(f"toy-{scene}", True), damage=(0.0, 2 * damage + 0.02 * scene))
            return replace(here, suspects=suspects, verifications=(0, 1))

        under = [of(scene) for scene in range(6)]
        return {"none": [replace(one, suspects=()) for one in under], "pgd": under, "ramp": under}

    found = {SHIPPED: played(0.2, (1,)), "g₂ = 8": played(0.3, (1, 3))}
    console = Console(width=300, record=True)
    console.print(table(found, args))
    shipped, other = (line for line in console.export_text().splitlines() if "│ as" in line or "│ g₂" in line)
    assert "+0.100 [+0.100, +0.100]" in other and "0.000 *" in other
    assert [cell.strip() for cell in other.split("│")][-4:-1] == ["0", "12", "0.50"]
    assert "*" not in shipped


def test_what_was_played_is_read_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Played here once for all values, which are kept apart; then no process is started."""
    args = Args(scenes=ToySource(n_frames=2), n_scenes=1, frames=2, attacks=("noise",), out=tmp_path)  # type: ignore[arg-type]
    labels = [name if value is None else f"{name} = {value:g}" for name, value in values()]
    for label in labels:
        play(args, label, None, label)
    monkeypatch.setattr(bayes_choices.multiprocessing, "get_context", lambda *_: pytest.fail("it was played again"))
    found = bayes_choices.survey(args)
    assert list(found) == labels and all(set(of) == {"none", "noise"} for of in found.values())
    _, conditions = plan(args)
    assert len({store_of(args, label, conditions).root for label in labels}) == len(labels)
