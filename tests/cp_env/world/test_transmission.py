"""δ is a plain tensor inside the ball, whatever an attack makes of it."""

from __future__ import annotations

from typing import Any

import pytest
import torch

from cp_env.settings import Settings
from cp_env.world.scene_cache import SceneBank
from cp_env.world.transmission import transmit
from cp_env.world.world import World


class Loose(torch.Tensor):
    """A tensor that will not be clamped, nor measured."""

    def clamp(self, *args: Any, **options: Any) -> Any:
        return self

    def norm(self, *args: Any, **options: Any) -> Any:
        return torch.zeros(())


@pytest.fixture
def world(bank: SceneBank) -> World:
    world = World(2, defender="none", bank=bank, attackers=(1, 3), grace_frames=0)
    world.reset([0, 1])
    return world


def loud(world: World) -> torch.Tensor:
    return torch.full((2, 2, *world.current().received.shape[2:]), 9.0)


@pytest.mark.parametrize("norm", ["linf", "l2"])
@pytest.mark.parametrize("budget", [0.0, 0.3, 3.0])
def test_no_norm_exceeds_the_budget(bank: SceneBank, norm: Any, budget: float) -> None:
    world = World(2, defender="none", bank=bank, attackers=(1, 3), grace_frames=0, norm=norm, budget=budget)
    world.reset([0, 1])
    for delta in (loud(world), -loud(world), torch.randn_like(loud(world)) * 1e6):
        norms = transmit(world.current(), delta, world.settings)
        assert (norms <= budget * (1 + 1e-5)).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.as_subclass(Loose), "plain torch.Tensor, not Loose"),
        (lambda d: d.numpy(), "plain torch.Tensor, not ndarray"),
        (lambda d: None, "plain torch.Tensor, not NoneType"),
        (lambda d: d[:, :1], "must have shape"),
        (lambda d: d.to_sparse(), "dense real numbers"),
        (lambda d: d.to(torch.complex64), "dense real numbers"),
        (lambda d: d.long(), "dense real numbers"),
        (lambda d: d * torch.nan, "must be finite"),
        (lambda d: d * torch.inf, "must be finite"),
    ],
)
def test_what_is_no_perturbation_is_refused(world: World, change: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        transmit(world.current(), change(loud(world)), world.settings)


def test_a_refused_perturbation_plays_nothing(world: World) -> None:
    frame = world.current().frame.copy()
    with pytest.raises(ValueError, match="must be finite"):
        world.step(loud(world) * torch.nan)
    assert (world.current().frame == frame).all()


def test_a_leaf_that_requires_grad_and_a_parameter_are_plain(world: World) -> None:
    expected = transmit(world.current(), loud(world), world.settings)
    for delta in (loud(world).requires_grad_(), torch.nn.Parameter(loud(world)), loud(world).double()):
        norms = transmit(world.current(), delta, world.settings)
        assert (norms == expected).all()


def test_the_budget_of_the_settings_counts_and_no_other(world: World) -> None:
    """The situation that was handed out may be written: the world reads its own."""
    handed = world.situation()
    object.__setattr__(handed, "budget", 1e6)
    object.__setattr__(handed, "norm", "l2")
    handed.active[:] = True
    outcome = world.step(loud(world))
    assert (outcome.perturbation_norm <= 0.3 * (1 + 1e-5)).all()
    assert isinstance(world.settings, Settings) and world.current().budget == 0.3
