"""The base class of attacks keeps one generator a world, whatever it is given."""

from __future__ import annotations

import re
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import agents
from cp_env.attack import Attack, streams
from cp_env.world.situation import Situation
from tests.helpers import situations


class SixLines(agents.Attack):
    """The attack that a newcomer writes first: one draw a world."""

    def act(self, situation: Any) -> torch.Tensor:
        shape, budget = situation.delta_shape[1:], situation.budget
        draws = [rng.uniform(-budget, budget, shape) for rng in self.rngs]  # type: ignore[attr-defined]
        return torch.tensor(np.stack(draws), dtype=torch.float32, device=situation.device)


def test_an_attack_of_one_method_draws_for_each_world() -> None:
    situation = situations.situation(situations.detector())
    attack = SixLines()
    attack.reset(2, [np.random.default_rng(5), np.random.default_rng(6)])
    both = attack.act(situation)
    attack.reset(2, [np.random.default_rng(6), np.random.default_rng(5)])
    assert torch.equal(attack.act(situation), both.flip(0))


def test_a_single_generator_is_as_good_as_those_spawned_from_it() -> None:
    situation = situations.situation(situations.detector())
    attack, drawn = SixLines(), []
    for rng in (np.random.default_rng(3), np.random.default_rng(3).spawn(2)):
        attack.reset(2, rng)
        drawn.append(attack.act(situation))
    assert torch.equal(*drawn)


def test_a_frozen_dataclass_may_be_an_attack() -> None:
    @dataclass(frozen=True)
    class Fixed(Attack):
        size: float = 0.5

        def act(self, situation: Any) -> torch.Tensor:
            return torch.full(situation.delta_shape, self.size)

    attack = Fixed(0.25)
    attack.reset(3, np.random.default_rng(0))
    assert len(attack.rngs) == 3 and attack.size == 0.25  # type: ignore[attr-defined]


def test_act_must_be_written() -> None:
    class Nothing(Attack):
        pass

    with pytest.raises(TypeError, match="abstract"):
        Nothing()  # type: ignore[abstract]


def test_an_object_with_both_methods_is_an_attack_too() -> None:
    class Duck:
        def reset(self, n_worlds: int, rng: object) -> None: ...

        def act(self, situation: object) -> None: ...

    assert isinstance(Duck(), Attack) and not isinstance(object(), Attack)
    assert agents.make("noise").__class__.__name__ == "Noise" and isinstance(agents.make("noise"), Attack)


def test_generators_must_be_one_a_world() -> None:
    own = [np.random.default_rng(i) for i in range(2)]
    assert streams(2, own) == own and len(streams(3, np.random.default_rng(0))) == 3
    with pytest.raises(ValueError, match="3 worlds, 2 generators"):
        streams(3, own)
    for wrong in (0, [0, 1], None):
        with pytest.raises(ValueError, match="rng must be numpy generators"):
            streams(2, wrong)


def test_the_page_names_all_that_a_situation_holds() -> None:
    page = (Path(agents.__file__).parents[1] / "docs/write-your-own-attack.md").read_text()
    (table,) = re.findall(r"\n\| field \|.*?\n\n", page, re.DOTALL)
    cells = "".join(line.split("|")[1] for line in table.strip().splitlines())
    told = set(re.findall(r"`(\w+)", cells))
    held = {field.name for field in fields(Situation)}
    held |= {name for name in vars(Situation) if not name.startswith("_")}
    assert told == held - {"handed_out", "receive", "perceive_clean"}  # the last two are behind `received` and `clean`
