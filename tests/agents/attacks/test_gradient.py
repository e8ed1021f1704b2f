from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

import agents
from agents.attacks import gradient, schedule
from agents.attacks.gradient import GradientAttack
from agents.protocol import Attack
from cp_env.detector.model.detector import FUSIONS
from tests.helpers import situations

MODEL = situations.detector()
NORMS = {"linf": 0.3, "l2": 3.0}
FEW = {  # signs make much of the last bits, in which a sum over views or cells depends on the batch
    "eot": {"steps": 2},
    "phantom_ahead": {"steps": 2},
}
FAMILY = (
    *agents.names(),
    "pgd:restarts=3,joint=False,steps=3",
    "pgd:objective=hide,momentum=0.5,steps=4",
    "pgd:objective=spoof,schedule=every@1,steps=4",
    "bim:objective=remove@1,steps=4",
    "pgd:objective=plant@10:4:0.5,steps=4",
    "cw:c=10.0,steps=4,joint=False",
)
RANDOM_ONES = ("noise", *(s for s in FAMILY if "restarts" not in s and s.startswith("pgd")))


def _made(spec: str, **options: Any) -> Attack:
    return agents.make(spec, **options)


def _act(spec: str, situation: Any, seed: int = 0, **options: Any) -> torch.Tensor:
    attack = _made(spec, **options)
    attack.reset(len(situation.active), np.random.default_rng(seed))
    return attack.act(situation)


def _loss(situation: Any, delta: torch.Tensor) -> torch.Tensor:
    return situations.value(situation, delta)


def _norm(name: str, delta: torch.Tensor) -> torch.Tensor:
    return delta.abs().amax((-3, -2, -1)) if name == "linf" else delta.flatten(-3).norm(dim=-1)


@pytest.mark.parametrize("norm", NORMS)
def test_gradients_beat_noise_beats_nothing_much(norm: str) -> None:
    situation = situations.situation(MODEL, n_worlds=4, norm=norm, budget=NORMS[norm])
    step = {"step_size": NORMS[norm] / 3}
    loss = {name: _loss(situation, _act(name, situation, **step)) for name in ("pgd", "bim")}
    noise = _loss(situation, _act("noise", situation))
    nothing = _loss(situation, _act("none", situation))
    assert (nothing.abs() < 1e-3).all()
    for name in loss:
        assert (loss[name] > 5 * noise).all() and (loss[name] > 0.05).all()


@pytest.mark.parametrize("norm", NORMS)
@pytest.mark.parametrize("spec", FAMILY)
def test_every_attack_stays_in_the_ball(spec: str, norm: str) -> None:
    for budget in (0.01, 0.3, 5.0):
        delta = _act(spec, situations.situation(MODEL, norm=norm, budget=budget))
        assert (
            delta.shape == (2, 2, situations.CHANNELS, situations.SIZE, situations.SIZE)
            and delta.dtype == torch.float32
        )
        assert not delta.requires_grad and torch.isfinite(delta).all()
        assert (_norm(norm, delta) <= budget * (1 + 1e-6)).all()


@pytest.mark.parametrize("name", ["pgd", "bim", "mi_fgsm", "cw"])
def test_more_steps_and_more_budget_are_not_weaker_on_average(name: str) -> None:
    situation = situations.situation(MODEL, n_worlds=4)
    by_steps = [_loss(situation, _act(name, situation, steps=steps)).mean() for steps in (0, 1, 4, 15)]
    assert by_steps == sorted(by_steps) and by_steps[-1] > by_steps[1]
    by_budget = []
    for budget in (0.03, 0.1, 0.3):
        situation = situations.situation(MODEL, n_worlds=4, budget=budget)
        by_budget.append(_loss(situation, _act(name, situation, step_size=budget / 3)).mean())
    assert by_budget == sorted(by_budget)


@pytest.mark.parametrize("spec", FAMILY)
def test_the_same_seed_attacks_the_same_and_another_differently(spec: str) -> None:
    situation = situations.situation(MODEL)
    assert torch.equal(_act(spec, situation, seed=0), _act(spec, situation, seed=0))
    if spec in RANDOM_ONES:
        assert not torch.equal(_act(spec, situation, seed=0), _act(spec, situation, seed=1))


@pytest.mark.parametrize("spec", FAMILY)
def test_a_world_in_a_batch_is_attacked_as_alone(spec: str) -> None:
    """The last world of three, with its own stream, against that world alone; its neighbours differ from it.

    A gradient that is zero but for rounding has any sign: from this stream none starts at such a place.
    """
    many = situations.situation(MODEL, n_worlds=3)
    alone = situations.situation(MODEL, n_worlds=1, first=2)
    batched, single = (_made(spec, **FEW.get(spec, {})) for _ in range(2))
    batched.reset(3, [np.random.default_rng(seed) for seed in (5, 6, 9)])
    single.reset(1, [np.random.default_rng(9)])
    for _ in range(2):
        torch.testing.assert_close(batched.act(many)[2:], single.act(alone), rtol=0, atol=1e-4)


@pytest.mark.parametrize("spec", FAMILY)
def test_worlds_find_apart_what_they_find_together(spec: str, monkeypatch: pytest.MonkeyPatch) -> None:
    situation, few = situations.situation(MODEL, n_worlds=3), {"blind": {"steps": 2}, **FEW}.get(spec, {})
    together = _act(spec, situation, **few)
    monkeypatch.setattr(gradient, "BATCH_WORLDS", {"cpu": 2})
    torch.testing.assert_close(_act(spec, situation, **few), together, rtol=0, atol=1e-4)


@pytest.mark.parametrize("spec", FAMILY)
def test_the_victim_is_frozen(spec: str) -> None:
    before = MODEL.digest
    situation = situations.situation(MODEL)
    held = {field: getattr(situation, field).clone() for field in ("received", "coverage", "ego_T_sender")}
    held |= {"clean": situation.clean.logits.clone()}
    _act(spec, situation)
    assert MODEL.digest == before
    assert all(parameter.grad is None and not parameter.requires_grad for parameter in MODEL.parameters())
    assert torch.equal(situation.clean.logits, held.pop("clean"))
    assert all(torch.equal(getattr(situation, field), value) for field, value in held.items())


@pytest.mark.parametrize("name", ["pgd", "bim"])
def test_only_attackers_with_an_effect_perturb(name: str) -> None:
    fused = torch.ones(4, 4, dtype=torch.bool)
    situation = situations.situation(MODEL, n_worlds=4, active=torch.tensor([True, False, True, True]), fused=fused)
    fused[2, situation.attackers[2, 0]] = False
    fused[3, situation.attackers[3]] = False
    moved = _norm("linf", _act(name, situation, target_groups="fused")) > 0
    assert moved.tolist() == [[True, True], [False, False], [False, True], [False, False]]
    moved = _norm("linf", _act(name, situation, target_groups="everyone")) > 0
    assert moved.tolist() == [[True, True], [False, False], [True, True], [True, True]]


def test_a_world_without_targets_costs_no_forward(monkeypatch: pytest.MonkeyPatch) -> None:
    situation = situations.situation(MODEL, active=torch.zeros(2, dtype=torch.bool))
    monkeypatch.setattr(gradient, "attack_loss", lambda *_: pytest.fail("nothing is attacked"))
    assert not _act("pgd", situation).any()


@pytest.mark.parametrize("everyone", [True, False])
def test_fusing_the_benign_once_changes_nothing(everyone: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    situation = situations.situation(MODEL, n_worlds=3)
    groups = torch.ones_like(situation.fused)
    if not everyone:
        groups[0, situation.attackers[0, 0]] = groups[1, situation.attackers[1, 1]] = groups[2, 0] = False
    delta = _act("noise", situation)

    def gradient() -> tuple[torch.Tensor, torch.Tensor]:
        leaf = delta.clone().requires_grad_()
        loss = situations.value(situation, leaf, target_groups=situations.groups_of(groups))
        return loss.detach(), torch.autograd.grad(loss.sum(), leaf)[0]

    fast = gradient()
    monkeypatch.setitem(FUSIONS, "as any other", FUSIONS["mean"])
    monkeypatch.setattr(MODEL, "fusion", "as any other")
    for quick, slow in zip(fast, gradient(), strict=True):
        torch.testing.assert_close(quick, slow, rtol=1e-3, atol=1e-6)
    assert fast[1].abs().amax((-3, -2, -1)).gt(0).tolist() == groups.gather(1, situation.attackers).tolist()


def test_bad_input_says_what_to_do() -> None:
    with pytest.raises(ValueError, match=r"known: none, noise, .*pgd, bim, mi_fgsm, cw"):
        agents.make("fgsm")
    with pytest.raises(ValueError, match="options"):
        agents.make(GradientAttack(), steps=3)
    with pytest.raises(ValueError, match="step_size"):
        agents.make("pgd", step_size=0.0)
    with pytest.raises(
        ValueError, match=r"unknown option of attack 'bim' 'size'.*known: steps, step_size, momentum, random_start"
    ):
        agents.make("bim", size=0.1)
    with pytest.raises(ValueError, match="unknown option of attack 'noise' 'steps'"):
        agents.make("noise", steps=3)
    with pytest.raises(ValueError, match="momentum"):
        agents.make("pgd", momentum=-1)
    with pytest.raises(ValueError, match="restarts counts the starts"):
        agents.make("bim", restarts=0)
    with pytest.raises(ValueError, match="unknown objective 'hid'; known: both, hide, spoof, detection_loss, "):
        agents.make("pgd", objective="hid")
    with pytest.raises(ValueError, match="does not take these numbers"):
        agents.make("pgd", objective="hide@3")
    with pytest.raises(ValueError, match="behind an @ stand numbers"):
        agents.make("pgd", objective="plant@here")
    with pytest.raises(ValueError, match="unknown schedule 'never'"):
        agents.make("pgd", schedule="never")
    with pytest.raises(ValueError, match="target_groups"):
        agents.make("pgd", target_groups="nobody")
    with pytest.raises(ValueError, match="2 worlds, 1 generators"):
        agents.make("pgd").reset(2, [np.random.default_rng(0)])
    with pytest.raises(ValueError, match="period"):
        schedule.every(0)
