"""Attacks on what the ego follows: whom they aim at, by hand, and what they reach on recorded streets."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

import agents
from agents.attacks.leader import EgoHeadings, LeaderAttack, _Lane
from cp_env.detector.model.decoder import Dense
from cp_env.metrics.severity import near
from cp_env.world.scene_cache import SceneBank
from cp_env.world.situation import Situation
from cp_env.world.world import World
from tests.helpers import situations

MODEL = situations.detector()
ROW, COLUMN = 16, 15  # the cell with centre (-1, 1) m


def cars(*boxes: tuple[float, float, float], worlds: int = 1) -> Situation:
    """An ego at the origin of its grid frame; cars of 4 m by 2 m with (x, y, yaw) in the clean view."""
    logits, code = torch.full((worlds, 32, 32), -6.0), torch.zeros(worlds, 6, 32, 32)
    for x, y, yaw in boxes:
        column, row = int((x + 32) // 2), int((y + 32) // 2)
        logits[:, row, column] = 4.0
        offset = [x - (2 * column - 31), y - (2 * row - 31)]
        code[:, :, row, column] = torch.tensor(
            [*offset, np.log(4.0), np.log(2.0), np.sin(2 * yaw), np.cos(2 * yaw)], dtype=torch.float32
        )
    one = situations.situation(MODEL, n_worlds=worlds)
    return replace(one, perceive_clean=lambda: Dense(logits, code), place=np.zeros((worlds, 2)))


def facing(angle: float) -> _Lane:
    return _Lane(EgoHeadings(np.array([angle]), np.zeros((1, 2))))


def test_headings_follow_the_motion_and_begin_anew_with_an_episode() -> None:
    headings, one = EgoHeadings(), cars(worlds=2)

    def at(*places: tuple[float, float], frame: int) -> list[float]:
        headings.update(replace(one, place=np.array(places, dtype=float), frame=np.array([frame, frame])))
        return headings.angle.tolist()

    assert np.isnan(at((0, 0), (0, 0), frame=0)).all()
    first = at((0.1, 0), (0, 2), frame=1)
    assert np.isnan(first[0]) and first[1] == pytest.approx(np.pi / 2)
    assert at((0.4, 0), (0, 2), frame=2) == pytest.approx([0, np.pi / 2]), "slow motion adds up; who stands keeps his"
    assert np.isnan(at((50, 0), (9, 9), frame=0)).all()


def test_the_target_is_the_nearest_in_the_lane_ahead() -> None:
    ahead, abreast, behind = (13.0, 0.5, 0.0), (5.0, 5.0, 0.0), (-7.0, 0.5, 0.0)
    found = facing(0.0).nearest(cars(ahead, abreast, behind))[0]
    assert found[0, :2].tolist() == pytest.approx([13.0, 0.5], abs=1e-3)
    assert torch.isnan(found[1]).all()
    assert facing(np.pi).nearest(cars(ahead, abreast, behind))[0, 0, :2].tolist() == pytest.approx([-7, 0.5], abs=1e-3)


def test_with_an_empty_lane_it_is_the_nearest_at_all_and_with_nobody_none() -> None:
    assert facing(np.pi / 2).nearest(cars((13.0, 0.5, 0.0), (5.0, 5.0, 0.0)))[0, 0, :2].tolist() == pytest.approx(
        [5, 5], abs=1e-3
    )
    assert torch.isnan(facing(0.0).nearest(cars())).all()


def test_before_the_ego_has_moved_both_ends_of_its_own_box_are_the_lane() -> None:
    own, ahead, behind, abreast = (0.0, 0.0, 0.0), (13.0, 0.5, 0.0), (-7.0, 0.5, 0.0), (3.0, 7.0, 0.0)
    found = facing(np.nan).nearest(cars(own, ahead, behind, abreast))[0, :, 0]
    assert sorted(found.tolist()) == pytest.approx([-7, 13], abs=1e-3)


def test_the_phantom_drives_at_the_gap_and_heads_as_the_ego() -> None:
    """Two half cars of 2.25 m and 6 m between them."""
    assert facing(np.pi / 2).ahead(cars(), 6.0)[0, 0].tolist() == pytest.approx(
        [0, 10.5, 4.5, 1.9, np.pi / 2], abs=1e-5
    )
    assert torch.isnan(facing(np.nan).ahead(cars(), 6.0)).all()


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("phantom_ahead:gap=0", "more than 0"),
        ("phantom_ahead:gap=26", "at most 25"),
        ("phantom_ahead:keep=-1", "at least 0"),
        ("nearest_removal:keep=-1", "at least 0"),
        ("nearest_removal:gap=3", "unknown option"),
    ],
)
def test_bad_options_are_refused(spec: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        agents.make(spec)


def played(street: SceneBank, spec: str) -> list[Any]:
    """Four frames of two recorded streets without a defence."""
    world = World(2, defender="none", bank=street, attackers=(1, 2), max_frames=4)
    world.reset([0, 1], options=[{"scene": name} for name in street.source.names()[:2]])
    attack = agents.make(spec)
    attack.reset(2, np.random.default_rng(0))
    return [world.step(attack.act(world.situation())) for _ in range(4)][1:]


def test_it_hides_its_target_and_keeps_the_rest(street: SceneBank) -> None:
    attack = agents.make("nearest_removal")
    assert isinstance(attack, LeaderAttack)
    outcomes = played(street, "nearest_removal")
    loud = played(street, "pgd")
    hidden = [len(o.clean[e].seen.boxes) - len(o.output[e].seen.boxes) for o in outcomes for e in range(2)]
    assert np.mean(hidden) >= 0.9
    assert np.mean([o.damage for o in outcomes]) < 0.3 * np.mean([o.damage for o in loud])


def test_it_shows_a_car_ahead(street: SceneBank) -> None:
    """A box where the unattacked view has none: the difference of counts would hide it behind a car that is missed."""
    views = [(o.output[e].seen.boxes, o.clean[e].seen.boxes) for o in played(street, "phantom_ahead") for e in (0, 1)]
    shown = [(~near(output, clean).any(axis=1)).sum() for output, clean in views]
    assert np.mean(shown) >= 0.9
