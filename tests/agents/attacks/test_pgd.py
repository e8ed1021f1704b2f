"""Projected gradient steps against their written algorithm."""

from __future__ import annotations

import torch

from agents.attacks.objectives.untargeted import UntargetedObjective
from agents.attacks.targets import AttackTargets, ViewLoss
from cp_env.detector import Dense
from tests.agents.attacks.test_gradient import MODEL, _act, _loss
from tests.helpers import situations


def test_momentum_is_algorithm_1_of_dong_et_al() -> None:
    """Against a slow twin: g = μ g + ∇ / ‖∇‖₁, δ = clip(δ + α sign g); here every step improves on the last."""
    situation = situations.situation(MODEL, n_worlds=1, n_attackers=1)
    steps, alpha, decay = 5, 0.03, 0.7
    delta, velocity = torch.zeros(1, 1, situations.CHANNELS, situations.SIZE, situations.SIZE), torch.zeros(())
    for _ in range(steps):
        leaf = delta.clone().requires_grad_()
        (gradient,) = torch.autograd.grad(_loss(situation, leaf).sum(), leaf)
        velocity = decay * velocity + gradient / gradient.abs().sum()
        delta = (delta + alpha * velocity.sign()).clamp(-situation.budget, situation.budget)
    options = {"steps": steps, "step_size": alpha}
    assert torch.equal(_act("mi_fgsm", situation, momentum=decay, **options), delta)
    assert not torch.equal(_act("bim", situation, **options), delta)


def test_the_best_iterate_is_kept() -> None:
    """With absurdly long steps the last iterate is worse than an earlier one; what is returned is the best seen."""
    situation = situations.situation(MODEL)
    values: list[torch.Tensor] = []

    def spy(targets: AttackTargets) -> ViewLoss:
        view_loss = UntargetedObjective()(targets)

        def noted(dense: Dense) -> torch.Tensor:
            value = view_loss(dense)
            values.append(value.detach())
            return value

        return noted

    delta = _act("bim", situation, steps=9, step_size=0.6, objective=spy)
    seen = torch.stack(values)
    assert len(seen) == 10 and (seen[-1] < seen.amax(0)).any()
    torch.testing.assert_close(_loss(situation, delta), seen.amax(0))
