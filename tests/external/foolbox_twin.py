"""Foolbox's attacks on our loss: its loops and its steps, with our detector behind them."""

from __future__ import annotations

from typing import Any

import torch

from agents.attacks.targets import Loss
from cp_env.world.situation import Situation


def foolbox_attack(
    name: str, loss: Loss, situation: Situation, *, start: torch.Tensor | None, steps: int, step_size: float
) -> torch.Tensor:
    """δ [E, k, C, H, W] by the attack of that name. For Foolbox an attacker's map is an image of its own, and its class
    a matter of no interest; its models, losses and random starts are made to be overridden."""
    import eagerpy
    import foolbox

    (worlds, k), shape = situation.attackers.shape, situation.received.shape[2:]
    maps = torch.zeros(worlds * k, *shape, device=situation.received.device)

    class Attack(getattr(foolbox.attacks, name)):  # type: ignore[misc]
        def get_loss_fn(self, model: Any, labels: Any) -> Any:
            return lambda x: eagerpy.astensor(loss(x.raw.unflatten(0, (worlds, k))).sum())

        def get_random_start(self, x0: Any, epsilon: float) -> Any:
            assert start is not None
            return eagerpy.astensor(start.flatten(0, 1))

    attack = Attack(abs_stepsize=step_size, steps=steps, random_start=start is not None)
    bounds = (-2 * situation.budget, 2 * situation.budget)
    victim = foolbox.PyTorchModel(torch.nn.Identity().eval(), bounds, device=maps.device)
    labels = torch.zeros(len(maps), dtype=torch.long, device=maps.device)
    found: torch.Tensor = attack.run(victim, maps, foolbox.Misclassification(labels), epsilon=situation.budget)
    return found.unflatten(0, (worlds, k)).detach()
