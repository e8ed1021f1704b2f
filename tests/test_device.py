"""One code path for every device: nothing is left on the CPU that the detector needs elsewhere, nor the reverse.

There is no accelerator here; `tests.pretend` makes one up that is as strict about places. It shows no speed, and no
difference in rounding: what is computed there is bit for bit what is computed here.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import agents
from cp_env.action import make_action
from cp_env.bank import SceneBank
from cp_env.detector.coperception import CoperceptionDetector
from cp_env.detector.coperception.checkpoint import Weights
from cp_env.detector.protocol import DetectorLike
from cp_env.detector.weights import FOLDER, read_detector
from cp_env.game import Game
from cp_env.testing import check_detector
from cp_env.world import World
from examples.bring_your_own_detector import Toy
from tests.pretend import Away, pretended
from tests.reference import coperception as twin
from tests.toy import ToySource

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

    def view(eyes: CoperceptionDetector) -> Any:
        device = eyes.device
        maps = eyes.encode_grids(bev.to(device))
        received = eyes.warp(maps, torch.tensor([[0.0, 0, 0], [7.3, -4.1, 0.7]], device=device))[None]
        kept = torch.from_numpy(np.packbits(bev[:1].numpy(), axis=-1)).to(device)
        covered, everyone = torch.ones(1, 2, 32, 32, device=device), torch.ones(1, 2, dtype=torch.bool, device=device)
        dense = eyes.beside(kept).perceive(received, covered, torch.zeros(1, dtype=torch.long, device=device), everyone)
        return dense.logits.cpu(), eyes.detect(dense)[0].boxes

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
