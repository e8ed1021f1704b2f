"""PGD and BIM against those of Foolbox (the extra `attacks-check`): the same loss from the same start.

Its MI-FGSM sums signs where Dong et al. sum gradients, so ours is held to their Algorithm 1 instead: test_ascent.py.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

import agents
from agents.attacks.objectives.untargeted import UntargetedObjective
from agents.attacks.targets import attack_loss, collect_targets, everyone
from cp_env.perturbation.ball import make_ball
from cp_env.world.situation import Situation
from tests.external.foolbox_twin import foolbox_attack
from tests.helpers import situations

pytest.importorskip("foolbox", reason="pip install -e '.[attacks-check]'")

MODEL = situations.detector()
STEPS = 15
NORMS = {"linf": 0.3, "l2": 3.0}
THEIRS = {
    ("pgd", "linf"): "LinfProjectedGradientDescentAttack",
    ("pgd", "l2"): "L2ProjectedGradientDescentAttack",
    ("bim", "linf"): "LinfBasicIterativeAttack",
    ("bim", "l2"): "L2BasicIterativeAttack",
}


@pytest.mark.parametrize(("name", "norm"), THEIRS)
def test_the_same_loss_from_the_same_start(name: str, norm: str) -> None:
    situation = situations.situation(MODEL, n_worlds=4, norm=norm, budget=NORMS[norm])
    options: dict[str, Any] = {"steps": STEPS, "step_size": NORMS[norm] / 6}
    ours = agents.make(name, **options)
    ours.reset(4, [np.random.default_rng(seed) for seed in range(4)])
    start = torch.stack([_start(situation, norm, seed) for seed in range(4)]) if name == "pgd" else None
    loss = attack_loss(collect_targets(situation, everyone, situation.active, joint=True), UntargetedObjective())
    theirs = foolbox_attack(THEIRS[name, norm], loss, situation, start=start, **options)
    mine, other = situations.value(situation, ours.act(situation)), situations.value(situation, theirs)
    assert (other > 0.05).all()
    torch.testing.assert_close(mine.mean(), other.mean(), rtol=0.01, atol=0)


def _start(situation: Situation, norm: str, seed: int) -> torch.Tensor:
    """What `agents.make("pgd")` starts from in the world of that stream."""
    k, c, h, w = (situation.attackers.shape[1], *situation.received.shape[2:])
    return make_ball(norm).random((k, c, h, w), situation.budget, np.random.default_rng(seed))
