"""coperception's detector in the environment: encoded into the cache, attacked through its gradient, verified."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import agents
import cp_env
from cp_env.detector.coperception import load_checkpoint
from cp_env.world.scene_cache import SceneBank
from cp_env.world.world import World
from tests.helpers.toy_scenes import ToySource
from tests.reference import coperception as twin

pytestmark = pytest.mark.slow
FRAMES = 2


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Random weights that take some anchors for cars."""
    path = tmp_path_factory.mktemp("checkpoints") / "epoch_100.pth"
    twin.save(twin.random_state("max", rarity=1.0), path)
    return path


def test_by_its_name(checkpoint: Path) -> None:
    """An episode of guided attackers against PRBI: spaces have the detector's shape, the perturbation arrives."""
    env = cp_env.parallel_env(
        "prbi",
        detector="coperception",
        checkpoint=checkpoint,
        fusion="max",
        scenes=ToySource(n_frames=FRAMES, n_connected=2, rsu=False),
        n_vehicles=2,
        attackers=[1],
        max_frames=FRAMES,
    )
    observations, _ = env.reset(seed=0, options={"scene": "toy-0"})
    agent = env.possible_agents[0]
    assert observations[agent]["features"].shape == (256, 32, 32) == env.observation_space(agent)["features"].shape
    norms = []
    for _ in range(FRAMES):
        *_, infos = env.step({agent: np.full(8, 0.9, np.float32)})
        norms.append(infos[agent]["perturbation_norm"])
    assert norms[0] == 0 and 0 < norms[1] <= 0.3 + 1e-6, "grace first, then a perturbation"
    view = env.game.outcome.seen[0]
    assert view.score_map.shape == (64, 64) and len(view.detections.scores) > 0


def test_as_an_object(checkpoint: Path, tmp_path: Path) -> None:
    """Unattacked, the world perceives what the cache says, up to half precision; PGD changes it within its budget."""
    detector = load_checkpoint(checkpoint, fusion="max")
    bank = SceneBank(ToySource(n_frames=FRAMES, n_connected=2, rsu=False), detector, tmp_path, progress=False)
    world = World(1, defender="none", bank=bank, n_vehicles=2, attackers=(1,), grace_frames=0, max_frames=FRAMES)
    outcomes = []
    for attack in (agents.make("none"), agents.make("pgd", steps=2)):
        world.reset([0], options={"scene": "toy-0"})
        attack.reset(1, np.random.default_rng(0))
        clean = world.situation().clean.scores[0].numpy()
        outcomes.append(world.step(attack.act(world.situation())))
    silent, loud = outcomes
    assert silent.damage[0] == 0 and np.allclose(silent.seen[0].score_map, clean, atol=2e-3)
    assert 0 < loud.perturbation_norm[0, 0] <= 0.3 + 1e-6
    assert not np.allclose(loud.seen[0].score_map, clean, atol=2e-2)
