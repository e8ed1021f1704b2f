"""Attacks on what the ego follows: whom they aim at, by hand, and what they reach on recorded streets."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

import agents
from agents.attacks.leader import car_ahead, nearest_in_lane
from cp_env.detector.model.decoder import Dense
from cp_env.geometry.planar import grid_origin
from cp_env.metrics.severity import near
from cp_env.world.scene_cache import SceneBank
from cp_env.world.situation import Situation
from cp_env.world.world import World
from tests.helpers import situations

MODEL = situations.detector()
MIDDLES = "random:action=critical,reach=0", "random:action=critical,reach=0.8"


def cars(*boxes: tuple[float, float, float], heading: float) -> Situation:
    """An ego at the origin of its grid frame; cars of 4 m by 2 m with (x, y, yaw) in the clean view."""
    logits, code = torch.full((1, 32, 32), -6.0), torch.zeros(1, 6, 32, 32)
    for x, y, yaw in boxes:
        column, row = int((x + 32) // 2), int((y + 32) // 2)
        logits[:, row, column] = 4.0
        offset = [x - (2 * column - 31), y - (2 * row - 31)]
        code[:, :, row, column] = torch.tensor(
            [*offset, np.log(4.0), np.log(2.0), np.sin(2 * yaw), np.cos(2 * yaw)], dtype=torch.float32
        )
    one = situations.situation(MODEL, n_worlds=1)
    return replace(one, perceive_clean=lambda: Dense(logits, code), heading=np.array([heading]))


def test_the_target_is_the_nearest_in_the_lane_ahead() -> None:
    street = (13.0, 0.5, 0.0), (5.0, 5.0, 0.0), (-7.0, 0.5, 0.0)
    assert nearest_in_lane(cars(*street, heading=0.0))[0, 0, :2].tolist() == pytest.approx([13.0, 0.5], abs=1e-3)
    assert nearest_in_lane(cars(*street, heading=np.pi))[0, 0, :2].tolist() == pytest.approx([-7, 0.5], abs=1e-3)


def test_with_an_empty_lane_it_is_the_nearest_at_all_and_with_nobody_none() -> None:
    abreast = cars((13.0, 0.5, 0.0), (5.0, 5.0, 0.0), heading=np.pi / 2)
    assert nearest_in_lane(abreast)[0, 0, :2].tolist() == pytest.approx([5, 5], abs=1e-3)
    assert torch.isnan(nearest_in_lane(cars(heading=0.0))).all()


def test_the_egos_own_box_is_nobody() -> None:
    own, ahead = (0.5, 0.5, 0.0), (13.0, 0.5, 0.0)
    assert nearest_in_lane(cars(own, ahead, heading=0.0))[0, 0, 0].item() == pytest.approx(13, abs=1e-3)


def test_the_phantom_drives_at_the_gap_and_heads_as_the_ego() -> None:
    """Two half cars of 2.25 m and 6 m between them."""
    made = car_ahead(cars(heading=np.pi / 2), 6.0)
    assert made[0, 0].tolist() == pytest.approx([0, 10.5, 4.5, 1.9, np.pi / 2], abs=1e-5)


def test_a_world_tells_its_egos_headings(street: SceneBank) -> None:
    """The recorded motion of whoever drives agrees with it."""
    world = World(2, defender="none", bank=street, attackers=(), max_frames=8)
    world.reset([0, 1], options=[{"scene": name} for name in street.source.names()[:2]])
    told, places = [], []
    for _ in range(8):
        told.append(world.situation().heading)
        places.append(world.situation().place)
        world.step(torch.zeros(world.situation().delta_shape))
    motion = np.diff(places, axis=0)
    drives = np.linalg.norm(motion, axis=2) > 0.2
    assert drives.any()
    along = np.stack([np.cos(told), np.sin(told)], axis=-1)[1:]
    assert ((motion * along).sum(axis=2)[drives] > 0.95 * np.linalg.norm(motion, axis=2)[drives]).all()


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("phantom_ahead:gap=0", "more than 0"),
        ("phantom_ahead:gap=26", "at most 25"),
        ("phantom_ahead:keep=-1", "at least 0"),
        ("nearest_removal:keep=-1", "at least 0"),
        ("random:reach=1.5", "0 to 1"),
        ("random:reach=-0.1", "0 to 1"),
        ("random:reach=nan", "0 to 1|finite"),
        ("critical_removal:keep=1", "unknown option|no options"),
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
    outcomes = played(street, "nearest_removal")
    loud = played(street, "pgd")
    hidden = [len(o.clean[e].seen.boxes) - len(o.output[e].seen.boxes) for o in outcomes for e in range(2)]
    assert np.mean(hidden) >= 0.9
    assert np.mean([o.damage for o in outcomes]) < 0.3 * np.mean([o.damage for o in loud])


def test_it_hides_what_is_ahead(street: SceneBank) -> None:
    """More than half of what is within its reach ahead of the ego, and less of what is behind."""
    world = World(2, defender="none", bank=street, attackers=(1, 2), max_frames=4)
    world.reset([0, 1], options=[{"scene": name} for name in street.source.names()[:2]])
    attack = agents.make("critical_removal")
    attack.reset(2, np.random.default_rng(0))
    hidden: dict[bool, list[bool]] = {True: [], False: []}
    for _ in range(4):
        now = world.situation()
        outcome = world.step(attack.act(now))
        for e, place in enumerate(now.place - grid_origin(now.place)):
            boxes, heading = outcome.clean[e].seen.boxes, now.heading[e]
            along = (boxes[:, :2] - place) @ np.array([np.cos(heading), np.sin(heading)])
            gone = ~near(boxes, outcome.output[e].seen.boxes).any(axis=1)
            for ahead in (True, False):
                hidden[ahead] += gone[((along > 2) & (along < 16)) if ahead else (along < -10)].tolist()
    assert np.mean(hidden[True]) > 0.5 > np.mean(hidden[False])


def test_it_is_the_middle_of_the_action_map(street: SceneBank) -> None:
    """What `random` sends with a reach of 0, whatever its stream, and unlike what it sends with another."""
    scripted, *others = (played(street, spec) for spec in ("critical_removal", *MIDDLES))
    same = [[bool((a.damage == b.damage).all()) for a, b in zip(scripted, other, strict=True)] for other in others]
    assert all(same[0]) and not any(same[1])


def test_it_shows_a_car_ahead(street: SceneBank) -> None:
    """A box where the unattacked view has none: the difference of counts would hide it behind a car that is missed."""
    views = [(o.output[e].seen.boxes, o.clean[e].seen.boxes) for o in played(street, "phantom_ahead") for e in (0, 1)]
    shown = [(~near(output, clean).any(axis=1)).sum() for output, clean in views]
    assert np.mean(shown) >= 0.9
