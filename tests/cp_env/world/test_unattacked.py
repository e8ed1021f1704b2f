"""Frames without an attack are those of a world in which nobody attacks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from agents.attacks.gradient import no_perturbation
from cp_env.detector import Detector
from cp_env.metrics.certified import witnesses
from cp_env.world.counterfactual import views_under
from cp_env.world.scene_cache import SceneBank
from cp_env.world.world import World
from tests.helpers.toy_scenes import ToySource


@pytest.fixture
def fresh(detector: Detector, tmp_path: Path) -> SceneBank:
    return SceneBank(ToySource(n_frames=3), detector, tmp_path, progress=False)


def unattacked_world(bank: SceneBank) -> World:
    world = World(1, defender="none", bank=bank, n_vehicles=3, n_attackers=0, rsu=True, max_frames=2)
    world.reset([0], options=[{"scene": "toy-0", "start": 1}])
    return world


def test_the_clean_view_is_that_of_everyone(fresh: SceneBank) -> None:
    world = unattacked_world(fresh)
    ((episode, frame),) = world.places
    situation = world.situation()
    (seen,) = world.step(no_perturbation(situation)).seen
    clean = episode.clean_views[frame]
    assert clean.group == seen.group == {0, 1, 2, 3} and clean.frame == frame
    np.testing.assert_array_equal(clean.seen.boxes, seen.seen.boxes)
    np.testing.assert_array_equal(clean.score_map, seen.score_map)
    assert len(clean.seen.boxes)


def test_clean_outputs_are_ordinary_tensors_whoever_asks_first(fresh: SceneBank) -> None:
    with torch.inference_mode():
        logits = fresh.episode("toy-0", 3, True).clean.logits[0]
    assert not logits.is_inference()


def test_witnesses_are_the_single_views_that_find_a_vehicle(fresh: SceneBank) -> None:
    """Against views of one vehicle each, perceived by a world without an attack."""
    world = unattacked_world(fresh)
    ((episode, frame),) = world.places
    situation = world.situation()
    singles = [(0, frozenset({i})) for i in range(4)]
    views = views_under(situation, no_perturbation(situation), singles)
    assert episode.witnesses is not None
    expected = witnesses(
        [view.seen.boxes.astype(np.float64) for view in views], episode.truth[frame].astype(np.float64)
    )
    assert np.array_equal(episode.witnesses[frame], expected) and expected.shape == (len(episode.truth[frame]),)
