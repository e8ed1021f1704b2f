"""The small cut: every defender in this process, on toy scenes, at every place of a batch; and a difference is seen."""

from __future__ import annotations

import pytest

import defenders
from tests.campaign.case import Fault
from tests.campaign.equality import Args, cases, check, trajectories
from tests.helpers.toy_evaluation import toy_bank


@pytest.mark.parametrize("name", defenders.names())
def test_places_in_a_batch_do_not_matter(name: str) -> None:
    args = Args(name, attack="pgd:steps=1", scenes="toy", frames=3, batches=(1, 3))
    found = dict(trajectories(args, toy_bank()))
    assert list(found) == ["place 0 of 1", "place 0 of 3", "place 1 of 3", "place 2 of 3"]
    check(found)


def test_other_seeds_are_other_trajectories() -> None:
    one, other = (dict(trajectories(Args(scenes="toy", seed=seed, frames=2), toy_bank())) for seed in (0, 1))
    with pytest.raises(Fault, match="plays other frames than first: second"):
        check({"first": one["place 0 of 1"], "second": other["place 0 of 1"]})


def test_every_defender_is_a_case() -> None:
    assert [case.name.split()[0] for case in cases(0)] == list(defenders.names())
