"""Objectives that pull the output towards a given scene."""

from __future__ import annotations

import numpy as np
import pytest

from agents.attacks.objectives.scene_target import SceneTarget, last_output, lattice_ghosts, merged
from cp_env.geometry.planar import grid_origin
from cp_env.world.scene_cache import SceneBank
from cp_env.world.world import World
from tests.helpers import situations
from tests.helpers.attacked_scenes import FRAMES, MODEL, act


def test_ghosts_stand_still_in_the_world_while_the_ego_drives() -> None:
    situation = situations.situation(MODEL, place=np.array([[0.0, 0.0], [37.3, -12.9]]))
    here, there = lattice_ghosts(12.0)(situation)
    for boxes, place in ((here, situation.place[0]), (there, situation.place[1])):
        assert len(boxes) > 9 and (np.abs(boxes[:, :2]) <= MODEL.extent).all()
        crossing = (boxes[:, :2] + grid_origin(place)) / 12.0
        np.testing.assert_allclose(crossing, crossing.round(), atol=1e-4)
    assert merged(lattice_ghosts(12.0), lattice_ghosts(12.0))(situation)[0].shape == here.shape
    with pytest.raises(ValueError, match="spacing=3"):
        lattice_ghosts(3.0)


def test_a_picture_is_best_when_it_is_what_is_seen() -> None:
    """Of all views, the one that shows the picture's cars and nothing else has the highest score."""
    situation = situations.situation(MODEL, n_worlds=1)
    targets = situations.targets(situation)
    view_loss = SceneTarget(lattice_ghosts(12.0))(targets)
    drawn = SceneTarget(lattice_ghosts(12.0))._decoder_targets(targets)
    shown = situations.dense(drawn)
    best = view_loss(shown)
    for worse in (situations.dense(drawn, logit=-1.0), situations.dense(drawn, elsewhere=2.0), situation.clean):
        assert (view_loss(worse) < best - 1).all()


def test_in_the_first_frame_the_benign_view_is_what_is_remembered(street: SceneBank) -> None:
    world = World(1, defender="none", bank=street, max_frames=FRAMES)
    world.reset([3])
    clean = world.places[0][0].clean_views[world.places[0][1]]
    np.testing.assert_allclose(last_output(world.situation())[0], clean.seen.boxes, atol=0.05)
    outcome = world.step(act("none", world.situation()))
    place = world.situation().place[0]
    motion = outcome.output[0].origin - grid_origin(place)
    expected = outcome.output[0].seen.boxes[:, :2] + motion
    np.testing.assert_allclose(last_output(world.situation())[0][:, :2], expected, atol=1e-4)
