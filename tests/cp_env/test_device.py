"""One code path for every device: nothing is left on the CPU that the detector needs elsewhere, nor the reverse.

There is no accelerator here; `tests.helpers.pretended_device` makes one up that is as strict about places. It shows no
speed, and no difference in rounding: what is computed there is bit for bit what is computed here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import agents
from benchmarks import devices
from cp_env.detector.coperception import CoperceptionDetector
from cp_env.detector.coperception.checkpoint import Weights
from cp_env.detector.model.fusion import base
from cp_env.detector.model.weights import FOLDER, read_detector, save_detector
from cp_env.detector.protocol import DetectorLike
from cp_env.detector.training import evaluate, train
from cp_env.detector.training.data import RasterisedScene, encode, prepare
from cp_env.envs.actions.registry import make_action
from cp_env.envs.core import Game
from cp_env.testing import check_detector
from cp_env.world.scene_cache import SceneBank
from cp_env.world.world import World
from examples.bring_your_own_detector import Toy
from tests.helpers.pretended_device import Away, pretended
from tests.helpers.toy_scenes import ToySource
from tests.reference import coperception as twin

SOURCE = ToySource(n_frames=3, n_connected=3, rsu=False)


def shipped() -> Any:
    return read_detector(FOLDER / "mean.safetensors").freeze()


def toy() -> Any:
    return Toy().freeze()


def test_the_pretended_device_is_strict() -> None:
    with pretended():
        there = torch.zeros(3, device="meta")
        assert isinstance(there, Away) and there.device.type == "meta" and (there + 1).cpu().tolist() == [1, 1, 1]
        assert isinstance(torch.tensor([1.0, 2.0], device="meta") * 2 + torch.tensor(1.0), Away)
        with pytest.raises(RuntimeError, match="on the device and on the CPU meet"):
            there + torch.ones(3)
        with pytest.raises((RuntimeError, TypeError)):
            there.numpy()


@pytest.mark.parametrize("make", [toy, shipped])
def test_detectors_keep_the_rules_there_too(make: Callable[[], Any]) -> None:
    with pretended():
        detector = make().to("meta")
        assert detector.device.type == "meta"
        check_detector(detector, skip=["digest_tells_weights_apart"])


@pytest.mark.slow
def test_coperception_sees_the_same_there() -> None:
    weights = Weights(twin.random_state("disconet"), "a checkpoint")
    detector = CoperceptionDetector(weights, "disconet", 3, "affine")
    bev = (torch.rand(2, 13, 256, 256, generator=torch.Generator().manual_seed(0)) < 0.02).to(torch.uint8)

    def view(model: CoperceptionDetector) -> Any:
        device = model.device
        maps = model.encode_grids(bev.to(device))
        received = model.warp(maps, torch.tensor([[0.0, 0, 0], [7.3, -4.1, 0.7]], device=device))[None]
        context = torch.from_numpy(np.packbits(bev[:1].numpy(), axis=-1)).to(device)
        covered, everyone = torch.ones(1, 2, 32, 32, device=device), torch.ones(1, 2, dtype=torch.bool, device=device)
        dense = model.with_ego_context(context).perceive(
            received, covered, torch.zeros(1, dtype=torch.long, device=device), everyone
        )
        return dense.logits.cpu(), model.detect(dense)[0].boxes

    here = view(detector)
    with pretended():
        there = view(detector.to("meta"))
        assert torch.equal(here[0], there[0]) and np.array_equal(here[1], there[1])


def play(detector: DetectorLike, root: Path) -> list[tuple[float, float]]:
    """Two worlds, PGD against PRBI: damage and similarity of every frame."""
    bank = SceneBank(SOURCE, detector, root, progress=False)
    world = World(2, defender="prbi", bank=bank, n_vehicles=3, n_attackers=1, max_frames=3)
    attack = agents.make("pgd", steps=2)
    world.reset([0, 1])
    attack.reset(2, np.random.default_rng(0))
    outcomes = [world.step(attack.act(world.situation())) for _ in range(3)]
    return [(float(d), float(s)) for o in outcomes for d, s in zip(o.damage, o.similarity, strict=True)]


@pytest.mark.parametrize("make", [toy, shipped])
def test_episodes_are_the_same_there(make: Callable[[], Any], tmp_path: Path) -> None:
    here = play(make(), tmp_path / "here")
    with pretended():
        there = play(make().to("meta"), tmp_path / "there")
    assert here == there and any(damage > 0 for damage, _ in here)


@pytest.mark.parametrize("action", ["guided", "basis", "full"])
def test_so_are_the_agents_actions(action: str, tmp_path: Path) -> None:
    def rewards(detector: DetectorLike, root: Path) -> list[float]:
        bank = SceneBank(SOURCE, detector, root, progress=False)
        game = Game(
            1, "none", bank=bank, n_vehicles=3, n_attackers=1, max_frames=3, action=action, observation="compact"
        )
        game.reset([3])
        shape = make_action(action, detector.channels, detector.size).space.shape
        rng = np.random.default_rng(0)
        steps = [game.step(rng.uniform(-1, 1, (1, 1, *shape)).astype(np.float32)) for _ in range(3)]
        return [float(reward[0, 0]) for _, reward, _, _ in steps]

    here = rewards(toy(), tmp_path / "here")
    with pretended():
        there = rewards(toy().to("meta"), tmp_path / "there")
    assert here == there


@pytest.fixture
def one_by_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """Groups are fused one after the other there, too: all at once they sum in another order, and weights drift."""
    monkeypatch.setattr(base, "ONE_BY_ONE", ("cpu", "meta"))


LEARNING = train.Args(frames=1, egos=1, views=2, agents=2, threads=1, checkpoint_every=2, steps=3)


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> list[RasterisedScene]:
    return prepare(SOURCE, tmp_path_factory.mktemp("rasterised"), stride=2)


@pytest.mark.usefixtures("one_by_one")
@pytest.mark.parametrize("fusion", ["mean", "disconet"])
def test_so_is_what_training_makes_there(fusion: str, scenes: list[RasterisedScene], tmp_path: Path) -> None:
    """With a teacher, where there is one."""
    teacher = tmp_path / "teacher.safetensors"
    save_detector(train.begin(LEARNING), teacher)
    args = replace(LEARNING, fusion=fusion, teacher=teacher if fusion == "disconet" else None)
    here = train.train(replace(args, out=tmp_path / "here"), scenes)
    with pretended():
        there = train.train(replace(args, out=tmp_path / "there", device="meta"), scenes)
        assert there.device.type == "meta" and there.digest == here.digest
        save_detector(there, tmp_path / "there.safetensors")
    assert torch.equal(read_detector(tmp_path / "there.safetensors").decoder.head.bias, here.decoder.head.bias)


@pytest.mark.usefixtures("one_by_one")
def test_a_run_goes_on_on_another_device(scenes: list[RasterisedScene], tmp_path: Path) -> None:
    """Two steps there and the third here are three steps here."""
    whole = train.train(replace(LEARNING, out=tmp_path / "whole"), scenes)
    moved = replace(LEARNING, out=tmp_path / "moved")
    assert all(train.learning_rate(0, LEARNING) == train.learning_rate(1, replace(LEARNING, steps=n)) for n in (2, 3))
    with pretended():
        train.train(replace(moved, steps=2, device="meta"), scenes)
    assert train.train(moved, scenes).digest == whole.digest


def test_encoders_maps_and_figures_are_the_same_there(scenes: list[RasterisedScene], tmp_path: Path) -> None:
    weights, figures = tmp_path / "mean.safetensors", tmp_path / "figures.json"
    save_detector(read_detector(FOLDER / "mean.safetensors"), weights)

    def maps(device: str) -> list[np.ndarray]:
        detector = read_detector(weights).to(device)
        return [np.asarray(rasterised.maps) for rasterised in encode(scenes, detector, tmp_path / device)]

    def report(device: str) -> str:
        args = evaluate.Args(n_vehicles=2, frames=2, weights=weights, json=figures, device=device)
        evaluate.main(args)
        return figures.read_text()

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(evaluate, "open_source", lambda _: SOURCE)
        here = maps("cpu"), report("cpu")
        with pretended():
            there = maps("meta"), report("meta")
    assert all(np.array_equal(a, b) for a, b in zip(here[0], there[0], strict=True)) and here[1] == there[1]


def test_speed_is_measured_there_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(devices, "open_source", lambda _: ToySource(n_frames=2))
    args = devices.Args(batch=1, steps=2, rounds=1)
    with pretended():
        speed = devices.measure("meta", "max", args)
    assert (speed.device, speed.fusion) == ("meta", "max") and speed.views > 0 and speed.steps > 0
