"""The shipped heads: all behind one encoder, small, and reached by name from every constructor."""

from __future__ import annotations

import gymnasium
import pytest
import torch

import cp_env
from agents.sb3 import make_vec_env
from cp_env import evaluation
from cp_env.detector import load_detector
from cp_env.detector.model.fusion import FUSIONS
from cp_env.detector.model.weights import FOLDER, about, names, read_detector
from cp_env.detector.training.evaluate import GRID
from cp_env.registration import ENV_ID
from cp_env.settings import FUSIONS as NAMES
from tests.helpers.toy_scenes import ToySource


def test_every_fusion_ships_and_is_listed_alike() -> None:
    assert set(names()) == set(FUSIONS) and tuple(FUSIONS) == NAMES
    assert sum(path.stat().st_size for path in FOLDER.iterdir()) < 10e6


@pytest.mark.parametrize("name", FUSIONS)
def test_one_encoder_serves_them_all(name: str) -> None:
    path = FOLDER / f"{name}.safetensors"
    assert read_detector(path).maps_digest == read_detector(FOLDER / "mean.safetensors").maps_digest
    assert about(path)["calibrated"] == "town/calibration+junction/calibration"
    detector = load_detector(name)
    assert detector.fusion == name and detector.threshold in GRID
    assert not detector.training and not any(p.requires_grad for p in detector.parameters())


@pytest.mark.parametrize("name", FUSIONS)
def test_a_trained_head_is_no_other(name: str) -> None:
    """Each is a function of its own, on the same two maps."""
    maps = torch.rand(1, 2, 128, 32, 32, generator=torch.Generator().manual_seed(0))
    rest = torch.ones(1, 2, 32, 32), torch.zeros(1, dtype=torch.long), torch.ones(1, 2, dtype=torch.bool)
    logits = {other: load_detector(other).perceive(maps, *rest).logits for other in FUSIONS}
    assert all(not torch.equal(logits[name], logits[other]) for other in FUSIONS if other != name)
    if name in ("v2vnet", "disconet"):
        mean = load_detector("mean").fuse(maps, *rest)
        assert (load_detector(name).fuse(maps, *rest) - mean).abs().max() > 0.01


@pytest.mark.parametrize("name", FUSIONS)
def test_fusion_reaches_the_ego_through_every_constructor(name: str) -> None:
    source = ToySource(n_frames=2)
    options = {"fusion": name, "scenes": source, "defender": "none", "action": "basis"}
    games = (
        cp_env.parallel_env(**options).unwrapped.game,
        cp_env.vector_env(2, **options).unwrapped.game,
        gymnasium.make(ENV_ID, **options).unwrapped.game,
        make_vec_env(1, **options).game,
    )
    assert all(game.world.detector is load_detector(name) for game in games)
    conditions = evaluation.Conditions("town/test", ("test-urban-00",), fusion=name)
    assert evaluation.open_bank(conditions).detector is load_detector(name)
