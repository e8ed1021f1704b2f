"""Vehicles that appear and drop out: nothing is received from them, true or false."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import pytest
import torch

from cp_env.world.scene_cache import SceneBank
from cp_env.world.situation import Outcome
from cp_env.world.world import World
from defenders.protocol import Defender, Frame, Inspection, Query, Verdict


class Nosy(Defender):
    """Verifies all vehicles, together and one by one, and fuses all; records the present ones."""

    def reset(self, n_vehicles: int, rng: np.random.Generator) -> None:
        self.n, self.present, self.groups = n_vehicles, [], []

    def inspect(self, frame: Frame) -> Inspection:
        views = yield Query([range(self.n), *({0, i} for i in range(self.n))])
        self.present.append(frame.present)
        self.groups.append([view.group for view in views])
        return Verdict(range(self.n))


def played(bank: SceneBank, absent: Any, frames: int = 3, **options: Any) -> tuple[World, list[Outcome]]:
    world = World(
        1, **{"defender": Nosy(), "bank": bank, "n_vehicles": 3, "max_frames": 6, "grace_frames": 0, **options}
    )
    world.reset([0], options={"absent": absent})
    size = world.detector.channels, world.detector.size, world.detector.size
    perturbations = torch.randn((frames, 1, world.settings.k, *size), generator=torch.Generator().manual_seed(0))
    return world, [world.step(perturbation) for perturbation in perturbations]


def test_an_absent_vehicle_is_in_no_view(bank: SceneBank) -> None:
    world, outcomes = played(bank, {2: [1]}, attackers=(1,))
    (defender,) = world.defenders
    assert isinstance(defender, Nosy)
    everyone = frozenset(range(3))
    assert defender.present == [everyone, everyone - {2}, everyone]
    assert defender.groups[1] == [frozenset({0, 1}), frozenset({0}), frozenset({0, 1}), frozenset({0})]
    assert outcomes[1].output[0].group == outcomes[1].clean[0].group == frozenset({0, 1})
    assert outcomes[1].verifications[0] == 4  # as asked


def test_an_absent_attacker_attacks_nobody(bank: SceneBank) -> None:
    _, outcomes = played(bank, {1: range(2)}, attackers=(1,))
    assert [float(outcome.damage[0]) for outcome in outcomes[:2]] == [0, 0]
    assert [bool(outcome.perturbation_norm[0, 0]) for outcome in outcomes] == [False, False, True]


def test_what_was_clean_is_what_those_present_see(bank: SceneBank) -> None:
    """With everyone else away the clean output is the ego's own view."""
    _, outcomes = played(bank, {1: range(9), 2: range(9)}, attackers=(1,))
    for outcome in outcomes:
        assert outcome.clean[0].group == frozenset({0})
        assert outcome.clean[0].detections.boxes == pytest.approx(outcome.output[0].detections.boxes, abs=1e-4)


def test_attackers_know_who_is_there(bank: SceneBank) -> None:
    world, _ = played(bank, {1: [3]}, attackers=(1,))
    situation = world.situation()
    assert situation.present.tolist() == situation.fused.tolist() == [[True, False, True]]


def test_neighbours_and_the_next_episode_are_not_touched(bank: SceneBank) -> None:
    world = World(2, defender=Nosy(), bank=bank, n_vehicles=3, max_frames=6)
    world.reset([0, 1])
    world.reset([0], worlds=[0], options={"absent": {1: range(6)}})
    assert world.situation().present.tolist() == [[True, False, True], [True, True, True]]
    world.reset([0], worlds=[0])
    assert world.situation().present.all()


DEEP: list[Any] = functools.reduce(lambda inner, _: [inner], range(5000), [])


@pytest.mark.parametrize("absent", [{0: [1]}, {3: [1]}, [1], {1: 5}, DEEP, {"x" * 10**5: [1]}], ids=range(6))
def test_nonsense_is_refused(bank: SceneBank, absent: Any) -> None:
    with pytest.raises(ValueError, match="absent"):
        played(bank, absent)
