"""Laws of the action maps, and what the numbers of a guided action do."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from cp_env.envs.actions import ascent
from cp_env.envs.actions import guided as module
from cp_env.envs.actions.guided import Guidance
from cp_env.envs.actions.registry import make_action
from cp_env.perturbation.channel import norm_of
from cp_env.perturbation.objective import adversarial_loss
from cp_env.world.scene_cache import SceneBank
from cp_env.world.situation import Situation
from cp_env.world.world import World

E, K = 2, 2
STRENGTH, SPOOF, DRIFT, X, Y, WIDTH, PERSISTENCE, GATE = range(8)


def situation(bank: SceneBank, norm: str = "linf", grace_frames: int = 0) -> Situation:
    world = World(E, bank=bank, norm=norm, grace_frames=grace_frames, attackers=(1, 2), max_frames=6, defender="none")
    world.reset([0, 1])
    return world.situation()


def guided(**numbers: float) -> np.ndarray:
    """The same guided action for every slot: full strength unless said otherwise."""
    action = np.zeros((E, K, 8), dtype=np.float32)
    action[..., STRENGTH] = 1.0
    for name, value in numbers.items():
        action[..., globals()[name]] = value
    return action


def test_guided_ranges_by_hand() -> None:
    low, middle, high = (Guidance.read(torch.full((1, 1, 8), v), 32.0) for v in (-1.0, 0.0, 1.0))
    assert [g.strength.item() for g in (low, middle, high)] == [0.0, 0.5, 1.0]
    assert [g.x.item() for g in (low, middle, high)] == [-32.0, 0.0, 32.0]
    assert [g.width.item() for g in (low, middle, high)] == [4.0, 16.0, 64.0]
    assert [g.fires.item() for g in (low, middle, high)] == [0.0, 1.0, 1.0]


def test_guided_does_more_damage_than_noise_of_the_same_size(bank: SceneBank) -> None:
    here = situation(bank)
    noise = torch.randn((E, K, 128, 32, 32), generator=torch.Generator().manual_seed(0)).sign() * here.budget
    assert (_loss(here, make_action("guided", 128, 32)(guided(), here)) > _loss(here, noise)).all()


def test_a_search_in_bfloat16_does_as_much_to_the_victim_in_single_precision(bank: SceneBank) -> None:
    here = situation(bank)
    exact, rounded = (make_action("guided", 128, 32, one)(guided(), here) for one in (None, "bfloat16"))
    assert not torch.equal(exact, rounded)
    torch.testing.assert_close(_loss(here, rounded), _loss(here, exact), rtol=0.05, atol=0)


def _loss(here: Situation, delta: torch.Tensor) -> torch.Tensor:
    poses = here.ego_T_sender.gather(1, here.attackers[..., None].expand(-1, -1, 3))
    maps = here.received.clone()
    for e in range(E):
        maps[e, here.attackers[e]] += here.detector.warp(delta[e], poses[e])
    dense = here.detector.perceive(maps, here.coverage, torch.arange(E), here.fused)
    return adversarial_loss(dense, here.clean, hide=0.5, spoof=0.5, drift=0.5)


def test_the_strength_is_the_radius_and_the_gate_is_a_gate(bank: SceneBank) -> None:
    here = situation(bank)
    half = make_action("guided", 128, 32)(guided(STRENGTH=0.0), here)
    np.testing.assert_allclose(norm_of(half, "linf"), 0.15, rtol=1e-5)
    assert not make_action("guided", 128, 32)(guided(GATE=-0.5), here).any()
    assert not make_action("guided", 128, 32)(guided(STRENGTH=-1.0), here).any()


def test_the_aim_moves_the_damage(bank: SceneBank) -> None:
    here = situation(bank)
    changed = []
    for x in (-0.6, 0.6):
        delta = make_action("guided", 128, 32)(guided(X=x, WIDTH=-1.0), here)
        poses = here.ego_T_sender.gather(1, here.attackers[..., None].expand(-1, -1, 3))
        landed = here.detector.warp(delta, poses).abs().mean((0, 1, 2, 3))
        changed.append(float((landed * torch.arange(32)).sum() / landed.sum()))
    assert changed[0] < changed[1] - 3, "the mean column of the perturbation follows the aim"


def test_persistence_starts_from_the_last_perturbation_and_reset_forgets_it(bank: SceneBank) -> None:
    here = situation(bank)
    action_map = make_action("guided", 128, 32)
    first = action_map(guided(PERSISTENCE=1.0), here)
    second = action_map(guided(PERSISTENCE=1.0), here)
    assert not torch.equal(first, second)
    action_map.reset([0])
    third = action_map(guided(PERSISTENCE=1.0), here)
    assert torch.equal(third[0], first[0]), "world 0 begins again"
    assert not torch.equal(third[1], first[1]), "world 1 goes on"


def test_nothing_is_sent_in_grace_frames(bank: SceneBank) -> None:
    assert not make_action("guided", 128, 32)(guided(), situation(bank, grace_frames=1)).any()


def test_worlds_are_attacked_alike_in_any_parts(bank: SceneBank, monkeypatch: pytest.MonkeyPatch) -> None:
    """In any number at once, and δ by δ or together: the gate of one is shut, and of one attacker of another."""
    world = World(5, defender="none", bank=bank, n_attackers=2, grace_frames=0)
    world.reset(list(range(5)))
    actions = np.random.default_rng(0).uniform(-1, 1, (5, 2, 8)).astype(np.float32)
    actions[..., 7] = 1.0
    actions[1, :, 7] = actions[3, 0, 7] = -1.0
    found = []
    for together, one_by_one in ((1, ("cpu",)), (3, ("cpu",)), (16, ("cpu",)), (16, ())):
        monkeypatch.setitem(module.TOGETHER, "cpu", together)
        monkeypatch.setattr(ascent, "ONE_BY_ONE", one_by_one)
        steer = make_action("guided", bank.detector.channels, bank.detector.size)
        found.append([steer(actions, world.current()).clone() for _ in range(2)])
    assert all(torch.equal(a, b) for other in found[1:] for a, b in zip(other, found[0], strict=True))
    assert not found[0][0][1].any() and not found[0][0][3, 0].any() and found[0][0].any()
