"""Targeted objectives: numbers worked by hand, and one car among many on a shipped scene."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

import agents
from agents.attacks.objectives.targeted import APART, Plant, Remove, detection, plant, remove, spot
from agents.attacks.objectives.untargeted import UntargetedObjective
from agents.attacks.targets import Objective, collect_targets, everyone
from cp_env.detector import Dense
from cp_env.perturbation.objective import MARGIN, REACH
from cp_env.scenes import open_source
from cp_env.scenes.clip import Clip
from cp_env.types import Detections
from cp_env.world.situation import Situation
from cp_env.world.world import World
from tests.helpers import situations

MODEL = situations.detector()
CELL = 2.0  # m: the small detector has 32 cells on 64 m


def _street(*cells: tuple[int, int], logit: float = 4.0, worlds: int = 1) -> Situation:
    """Cars of 4 m by 2 m at the centres of these cells (row, column), in otherwise empty views."""
    logits, boxes = torch.full((worlds, 32, 32), -6.0), torch.zeros(worlds, 6, 32, 32)
    boxes[:, 2], boxes[:, 3], boxes[:, 5] = np.log(4.0), np.log(2.0), 1.0
    for row, column in cells:
        logits[:, row, column] = logit
    return replace(situations.situation(MODEL, n_worlds=worlds), perceive_clean=lambda: Dense(logits, boxes))


def _at(row: int, column: int) -> tuple[float, float]:
    """The centre of a cell, m."""
    return CELL * (column + 0.5) - 32, CELL * (row + 0.5) - 32


def _value(situation: Situation, objective: Objective, dense: Dense) -> float:
    return objective(collect_targets(situation, everyone, situation.active, joint=True))(dense).item()


def test_removing_counts_the_logits_around_the_car_alone() -> None:
    """Five cells lie within 2.5 m of a cell's centre: one of them says 4, four say -6, log-sum-exp 4.0002."""
    situation = _street((10, 10), (20, 20))
    objective = Remove(spot(_at(10, 10)))
    assert _value(situation, objective, situation.clean) == pytest.approx(-np.log(np.exp(4) + 4 * np.exp(-6)), rel=1e-5)
    hidden = situation.clean.logits.clone()
    hidden[0, 20, 20] = -9.0
    assert _value(situation, objective, Dense(hidden, situation.clean.boxes)) == _value(
        situation, objective, situation.clean
    )
    hidden[0, 10, 10] = -6.0
    assert _value(situation, objective, Dense(hidden, situation.clean.boxes)) == pytest.approx(MARGIN)
    hidden[0, 11, 10] = 1.0  # the next cell reports it instead
    assert _value(situation, objective, Dense(hidden, situation.clean.boxes)) == pytest.approx(-1.0, abs=0.01)


def test_planting_counts_one_cell_and_its_box() -> None:
    situation = _street((10, 10))
    x, y = _at(5, 25)
    objective, dense = plant(x + 0.5, y, length=4.0, width=2.0), _street((10, 10), (5, 25), logit=2.0).clean
    assert _value(situation, objective, situation.clean) == pytest.approx(-6.0 - 0.5 / 6, rel=1e-5)
    assert _value(situation, objective, dense) == pytest.approx(2.0 - 0.5 / 6, rel=1e-5)
    far = Dense(torch.full_like(dense.logits, 9.0), dense.boxes + 50.0)
    assert _value(situation, objective, far) == pytest.approx(MARGIN - REACH)


@pytest.mark.parametrize("kind", [Remove, Plant])
def test_keep_charges_for_changes_elsewhere(kind: Any) -> None:
    situation = _street((10, 10), (20, 20))
    place = spot((*_at(10, 10), 4.0, 2.0, 0.0))
    near, far = situation.clean.logits.clone(), situation.clean.logits.clone()
    near[0, 10, 10] = far[0, 20, 20] = 0.0
    loss = {keep: [_value(situation, kind(place, keep=keep), Dense(x, situation.clean.boxes)) for x in (near, far)]
            for keep in (0.0, 2.0)}  # fmt: skip
    assert loss[2.0][0] == pytest.approx(loss[0.0][0])
    change = (torch.tensor(4.0).sigmoid() - 0.5).item() ** 2
    assert loss[2.0][1] == pytest.approx(loss[0.0][1] - 2 * change, rel=1e-4)
    assert np.hypot(*np.subtract(_at(10, 10), _at(20, 20))) > APART


def test_the_target_is_a_place_or_a_detection_of_each_world() -> None:
    situation = _street((10, 10), (20, 21), worlds=2)
    lower = situation.clean.logits.clone()
    lower[1, 10, 10] = 2.0  # in world 1 the other car is the surer
    changed = Dense(lower, situation.clean.boxes)
    situation = replace(situation, perceive_clean=lambda: changed)
    torch.testing.assert_close(detection(0)(situation)[1, :2], torch.tensor(_at(20, 21)))
    torch.testing.assert_close(detection([1, 1])(situation)[1], torch.tensor([*_at(10, 10), 4.0, 2.0, 0.0]))
    rows = spot([_at(10, 10), _at(3, 3)])(situation)
    assert rows[1].tolist() == list(_at(3, 3))
    assert torch.isnan(detection([0, 7])(situation)).any(1).tolist() == [False, True]


def test_a_world_without_the_target_has_nothing_to_gain() -> None:
    situation = _street((10, 10), worlds=2)
    targets = collect_targets(situation, everyone, situation.active, joint=True)
    assert Remove(detection([0, 7]))(targets)(situation.clean)[1] == 0
    act = agents.make("bim", objective=Remove(detection([0, 7])))
    act.reset(2, np.random.default_rng(0))
    assert act.act(situation).flatten(1).any(1).tolist() == [True, False]


def test_places_outside_and_numbers_too_many_are_refused() -> None:
    situation = _street((10, 10))
    with pytest.raises(ValueError, match=r"within 32.0 m"):
        plant(40.0, 0.0)(collect_targets(situation, everyone, situation.active, joint=True))
    with pytest.raises(TypeError, match="number or x and y"):
        remove(1, 2, 3)


@pytest.fixture(scope="module")
def crossing() -> Situation:
    """One frame of a test scene in twelve worlds, two attackers of five drawn for each."""
    world = World(12, defender="none", scenes=Clip(open_source("town/test"), frames=2))
    world.reset(list(range(12)), options={"scene": world.bank.source.names()[0], "start": 0})
    world.step(torch.zeros(12, 2, *world.situation().received.shape[2:]))
    return world.situation()


def _seen(situation: Situation, budget: float, objective: Objective) -> list[Detections]:
    """The output of everyone fused under that attack, at the operating threshold."""
    attack = agents.make("pgd", objective=objective, step_size=budget / 3, steps=10)
    attack.reset(12, np.random.default_rng(0))
    delta = attack.act(replace(situation, budget=budget))
    with torch.no_grad():
        dense = collect_targets(situation, everyone, situation.active, joint=True).perceive()(delta)
    return [view.above(situation.detector.threshold) for view in situation.detector.detect(dense)]


def _shown(views: list[Detections], places: np.ndarray) -> np.ndarray:
    """Whether each view shows a car within 2 m of its place."""
    pairs = zip(views, places, strict=True)
    return np.array([(np.hypot(*(view.boxes[:, :2] - place[:2]).T) < 2).any() for view, place in pairs])


@pytest.mark.slow
def test_removing_one_car_removes_it_more_often_than_an_attack_on_all(crossing: Situation) -> None:
    """A car for each world, at budgets at which neither takes all; and the targeted ones leave the others alone."""
    target = detection([2 * e for e in range(12)])
    places, clean = target(crossing).numpy(), crossing.detector.detect(crossing.clean)
    cars = np.array([len(view.above(crossing.detector.threshold).scores) for view in clean])
    gone = {"one": 0, "all": 0}
    for budget in (0.1, 0.2):
        one, everything = _seen(crossing, budget, Remove(target)), _seen(crossing, budget, UntargetedObjective())
        gone["one"] += int((~_shown(one, places)).sum())
        gone["all"] += int((~_shown(everything, places)).sum())
        changed = [np.abs(np.array([len(view.scores) for view in views]) - cars).mean() for views in (one, everything)]
        assert changed[0] < changed[1] / 4
    assert gone["one"] > gone["all"] and gone["one"] >= 8


@pytest.mark.slow
def test_a_planted_car_is_seen(crossing: Situation) -> None:
    """At places drawn at random, 5 m or more from any car the ego sees."""
    rng, cars = np.random.default_rng(0), crossing.detector.detect(crossing.clean)[0].boxes[:, :2]
    drawn = rng.uniform(-20, 20, (200, 2))
    free = drawn[np.linalg.norm(cars - drawn[:, None], axis=-1).min(1) > 5][:12]
    boxes = np.concatenate([free, np.tile([4.5, 1.9, 0.5], (12, 1))], axis=1)
    views = _seen(crossing, 0.3, Plant(spot(boxes)))
    assert not _shown(crossing.detector.detect(crossing.clean), free).any()
    assert _shown(views, free).sum() >= 9
