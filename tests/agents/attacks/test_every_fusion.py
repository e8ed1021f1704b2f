"""Attacks go through every fusion: gradients beat noise, and an attacker outside the group does nothing."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import agents
from cp_env.detector import Detector
from cp_env.detector.model.fusion import FUSIONS
from tests.helpers import situations


def lively(name: str) -> Detector:
    """As `situations.detector`, with another fusion, none of whose layers is zero."""
    with torch.random.fork_rng():
        torch.manual_seed(0)
        model = Detector(fusion=name, channels=situations.CHANNELS)
        model.size, model.map_size = situations.SIZE, 2 * situations.SIZE
        with torch.no_grad():
            model.decoder.head.weight.mul_(30.0)
            model.decoder.head.bias.zero_()
            for parameter in model.fuser.parameters():
                if not parameter.any():
                    parameter.normal_(std=0.3)
    return model.freeze()


@pytest.mark.parametrize("name", FUSIONS)
def test_gradients_beat_noise_and_reach_members_only(name: str) -> None:
    model = lively(name)
    situation = situations.situation(model, n_worlds=2)
    damage = {}
    for attack in ("noise", "bim", "cw"):
        attack_instance = agents.make(attack)
        attack_instance.reset(2, np.random.default_rng(0))
        damage[attack] = situations.value(situation, attack_instance.act(situation)).mean()
    assert damage["bim"] > 3 * damage["noise"] and damage["cw"] > 2 * damage["noise"]
    groups = torch.ones_like(situation.fused)
    groups[0, situation.attackers[0, 0]] = False
    delta = torch.zeros(2, 2, situations.CHANNELS, situations.SIZE, situations.SIZE, requires_grad=True)
    loss = situations.value(situation, delta, target_groups=situations.groups_of(groups))
    (gradient,) = torch.autograd.grad(loss.sum(), delta)
    assert (gradient.abs().amax((-3, -2, -1)) > 0).tolist() == [[False, True], [True, True]]
