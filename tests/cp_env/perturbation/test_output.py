"""The ego's output under δ: the short way of a linear fusion beside the victim's own warp and fusion."""

from __future__ import annotations

import pytest
import torch

from cp_env.detector.model.weights import load_detector
from cp_env.perturbation.output import AttackedOutput, LinearOutput, attacked_output

WORLDS, MAPS, K = 3, 4, 2
ATTACKERS = torch.tensor([[0, 3], [1, 2], [2, 3]])


def drawn(whole: bool) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Maps, coverage and poses of the attackers, moved by whole cells of 2 m or turned; and their δ."""
    generator = torch.Generator().manual_seed(0)
    received = torch.rand(WORLDS, MAPS, 128, 32, 32, generator=generator)
    coverage = (torch.rand(WORLDS, MAPS, 32, 32, generator=generator) > 0.2).float()
    pose = torch.randint(-8, 9, (WORLDS, K, 3), generator=generator) * torch.tensor([2.0, 2.0, 0.0 if whole else 0.1])
    return received, coverage, pose, 0.1 * torch.randn(WORLDS, K, 128, 32, 32, generator=generator)


@pytest.mark.parametrize("whole", [True, False], ids=["whole cells", "turned"])
@pytest.mark.parametrize("worlds", [None, [2, 0]], ids=["all", "some"])
@pytest.mark.parametrize("views", ["one each", "several"])
def test_what_is_added_to_the_mean_is_what_the_victim_fuses(whole: bool, worlds: list[int] | None, views: str) -> None:
    detector = load_detector()
    received, coverage, pose, delta = drawn(whole)
    some = torch.arange(WORLDS) if worlds is None else torch.tensor(worlds)
    world = torch.arange(len(some)) if views == "one each" else torch.tensor([1, 0, 1])
    groups = torch.rand(len(world), MAPS, generator=torch.Generator().manual_seed(1)) > 0.3
    leaf = delta[some].requires_grad_()
    given = (ATTACKERS[some], pose[some], world, groups)
    short = attacked_output(detector, received, coverage, *given, worlds=None if worlds is None else some)
    plain = AttackedOutput(detector, received[some], coverage[some], *given)
    assert isinstance(short, LinearOutput) and (short.moves is not None) == whole
    torch.testing.assert_close(short(leaf).logits, plain(leaf).logits, atol=1e-4, rtol=1e-4)
    slopes = [torch.autograd.grad(one(leaf).logits.sigmoid().sum(), leaf)[0] for one in (short, plain)]
    assert torch.cosine_similarity(*(slope.flatten() for slope in slopes), dim=0) > 0.9999


def test_silent_senders_need_not_be_looked_at() -> None:
    detector = load_detector()
    received, coverage, pose, delta = drawn(whole=True)
    given = (detector, received, coverage, ATTACKERS, pose, torch.arange(WORLDS), torch.ones(WORLDS, MAPS).bool())
    sending = torch.tensor([[True, False], [False, False], [True, True]])
    delta[~sending] = 0
    few = attacked_output(*given, sending=sending)
    assert isinstance(few, LinearOutput) and few.moves is not None and len(few.moves.delta) == 3
    assert torch.equal(few(delta).logits, attacked_output(*given)(delta).logits)


@pytest.mark.parametrize("fusion", ["mean", "v2vnet"])
def test_a_rounded_copy_takes_maps_as_they_are(fusion: str) -> None:
    exact = load_detector(fusion)
    received, coverage, pose, delta = drawn(whole=True)
    given = (received, coverage, ATTACKERS, pose, torch.arange(WORLDS), torch.ones(WORLDS, MAPS).bool())
    found = [attacked_output(one, *given)(delta).logits for one in (exact, exact.with_precision("bfloat16"))]
    assert found[1].dtype == torch.float32 and not torch.equal(*found)
    torch.testing.assert_close(found[1].sigmoid(), found[0].sigmoid(), atol=0.1, rtol=0)
