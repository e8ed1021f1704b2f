"""bfloat16: a copy with half the bits, which sees what the detector sees, under a name of its own."""

from __future__ import annotations

from collections.abc import Sequence

import pytest
import torch

from cp_env import settings
from cp_env.detector import Dense, Detector, load_detector
from cp_env.detector.model import base
from cp_env.detector.model.base import BaseDetector
from cp_env.detector.registry import open_detector, precise
from cp_env.perturbation.output import attacked_output
from cp_env.types import Sweep
from cp_env.world.counterfactual import in_precision
from cp_env.world.scene_cache import SceneBank
from cp_env.world.world import World
from tests.helpers import situations

FUSIONS = ["mean", "max", "sum", "v2vnet", "disconet"]


class Plain(BaseDetector):
    """A detector that knows of no precision."""

    channels = 2

    def encode(self, sweeps: Sequence[Sweep]) -> torch.Tensor:
        return torch.zeros(len(sweeps), 2, 32, 32)

    def perceive(self, received: torch.Tensor, *_: torch.Tensor) -> Dense:
        return Dense(received[:, 0, 0], received[:, 0, :1].expand(-1, 6, -1, -1))


def maps() -> tuple[torch.Tensor, ...]:
    generator = torch.Generator().manual_seed(0)
    received = torch.rand(2, 3, 128, 32, 32, generator=generator)
    groups = torch.tensor([[1, 1, 1], [0, 1, 1], [0, 0, 1]]).bool()
    return received, torch.ones(2, 3, 32, 32), torch.tensor([0, 1, 1]), groups


@pytest.mark.parametrize("fusion", FUSIONS)
def test_outputs_are_single_precision_and_nearly_the_same(fusion: str) -> None:
    exact = load_detector(fusion)
    rounded = exact.with_precision("bfloat16")
    received, *rest = maps()
    with torch.inference_mode():
        expected = exact.perceive(received, *rest)
        found = rounded.perceive(received.bfloat16(), *rest)
    assert found.logits.dtype == found.boxes.dtype == torch.float32
    assert (found.logits - expected.logits).abs().mean() < 0.1 < expected.logits.std()


def test_it_is_a_copy_with_a_digest_of_its_own_and_the_maps_and_calibration_of_the_detector() -> None:
    exact = load_detector()
    before = exact.digest
    rounded = exact.with_precision("bfloat16")
    assert exact.digest == before and exact.dtype == torch.float32 and rounded.dtype == torch.bfloat16
    assert rounded.digest != before and rounded.maps_digest == exact.maps_digest
    assert rounded.calibration_digest == exact.calibration_digest == before
    assert exact.with_precision("float32") is exact and rounded.with_precision("bfloat16") is rounded


def test_precision_that_was_lost_does_not_come_back() -> None:
    with pytest.raises(ValueError, match="open the detector anew"):
        load_detector().with_precision("bfloat16").with_precision("float32")


def test_an_unknown_precision_and_a_detector_without_one_are_named() -> None:
    with pytest.raises(ValueError, match="bfloat16"):
        open_detector(precision="bfloat61")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="knows no precision but float32"):
        open_detector("tests.cp_env.detector.model.test_precision:Plain", precision="bfloat16")


@pytest.mark.parametrize("name", ["cp_env", "cp_env:fusion=max"])
def test_the_option_reaches_every_place_that_takes_a_name(name: str) -> None:
    assert precise(name, "float32") == name
    detector = open_detector(precise(name, "bfloat16"))
    assert isinstance(detector, Detector) and detector.dtype == torch.bfloat16


def test_the_gradient_points_the_same_way() -> None:
    exact = load_detector()
    received, coverage, world, groups = maps()
    attackers, pose = torch.tensor([[1], [2]]), torch.zeros(2, 1, 3)
    gradients = []
    for detector in (exact, exact.with_precision("bfloat16")):
        delta = torch.zeros(2, 1, 128, 32, 32, requires_grad=True)
        output = attacked_output(detector, received.to(detector.dtype), coverage, attackers, pose, world, groups)(delta)
        (gradient,) = torch.autograd.grad(output.logits.sigmoid().sum(), delta)
        assert gradient.dtype == torch.float32
        gradients.append(gradient.flatten())
    assert torch.cosine_similarity(*gradients, dim=0) > 0.98


def test_a_world_in_bfloat16_plays_much_the_same_episode(bank: SceneBank) -> None:
    rounded = SceneBank(bank.source, bank.detector.with_precision("bfloat16"), bank.root.parent, progress=False)  # type: ignore[attr-defined]
    outcomes = []
    for one in (bank, rounded):
        world = World(2, defender="prbi", bank=one, attackers=(1, 3), grace_frames=0)
        world.reset([0, 1])
        assert world.current().received.dtype == one.detector.dtype  # type: ignore[attr-defined]
        outcomes.append(world.step(torch.full(world.current().delta_shape, 0.1)))
    assert outcomes[0].perturbation_norm == pytest.approx(outcomes[1].perturbation_norm)
    for exact, near in zip(outcomes[0].seen, outcomes[1].seen, strict=True):
        assert abs(exact.score_map - near.score_map).max() < 0.1


def test_a_search_in_less_precision_leaves_the_situation_alone() -> None:
    exact = situations.situation(situations.detector())
    rounded = in_precision(exact, "bfloat16")
    assert exact.received.dtype == torch.float32 and rounded.received.dtype == torch.bfloat16
    assert in_precision(exact, "bfloat16").detector is rounded.detector and rounded.detector is not exact.detector


def test_options_and_detectors_name_the_same_precisions() -> None:
    assert settings.PRECISIONS == base.PRECISIONS
