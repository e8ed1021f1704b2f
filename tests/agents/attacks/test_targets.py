"""The groups whose views an attack targets, and their weights."""

from __future__ import annotations

from typing import Any

import pytest
import torch

from agents.attacks.targets import collect_targets
from tests.agents.attacks.test_gradient_options import MODEL, _act, _pairs
from tests.helpers import situations


def test_the_loss_is_the_weighted_sum_over_the_groups() -> None:
    situation = situations.situation(MODEL, n_worlds=3)
    groups, _ = _pairs(situation)
    delta = _act("noise", situation)
    whole = situations.value(situation, delta, target_groups=_pairs)
    parts = [situations.value(situation, delta, target_groups=situations.groups_of(groups[:, s])) for s in (0, 1)]
    torch.testing.assert_close(whole, parts[0] + 3 * parts[1], rtol=1e-4, atol=1e-5)


def test_an_attack_in_expectation_is_better_in_expectation() -> None:
    situation = situations.situation(MODEL, n_worlds=4)
    blunt, told = _act("bim", situation), _act("bim", situation, target_groups=_pairs)
    value = [situations.value(situation, delta, target_groups=_pairs).mean() for delta in (blunt, told)]
    assert value[1] > value[0]


def test_a_group_of_no_weight_and_one_without_attackers_are_left_out() -> None:
    situation = situations.situation(MODEL, n_worlds=2)
    groups = torch.ones(2, 3, 4, dtype=torch.bool)
    groups[:, 1].scatter_(1, situation.attackers, False)
    groups[:, 2] = False  # a filler, which must not be looked at
    weights = torch.tensor([[1.0, 5.0, 0.0]]).expand(2, -1)
    targets = collect_targets(situation, lambda _: (groups, weights), situation.active, joint=True)
    assert targets.team.tolist() == [0, 1] and targets.groups.all() and targets.weight.tolist() == [1.0, 1.0]


@pytest.mark.parametrize(
    "distribution",
    [
        (torch.ones(2, 4, dtype=torch.bool), torch.ones(2, 4)),
        (torch.ones(2, 1, 4, dtype=torch.bool), torch.ones(2, 2)),
        (torch.ones(2, 1, 4), torch.ones(2, 1)),
        (torch.ones(2, 1, 4, dtype=torch.bool), -torch.ones(2, 1)),
    ],
)
def test_a_crowd_that_cannot_be_is_refused(distribution: Any) -> None:
    with pytest.raises(ValueError, match="target_groups gives"):
        _act("bim", situations.situation(MODEL), target_groups=lambda _: distribution)
