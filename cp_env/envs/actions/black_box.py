"""Action maps that need no knowledge of the detector."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from cp_env.envs.actions.base import ActionMap
from cp_env.perturbation.channel import project
from cp_env.world.situation import Situation


class Full(ActionMap):
    """δ = Δ · action, entry by entry; for the L2 ball the result is then shortened to Δ."""

    def __init__(self, channels: int, size: int) -> None:
        super().__init__((channels, size, size))

    def __call__(self, actions: Float[np.ndarray, "E k *a"], situation: Situation) -> Float[Tensor, "E k C H W"]:
        delta = torch.from_numpy(actions).to(situation.device) * situation.budget
        return project(delta, situation.budget, situation.norm, out=delta)


class Basis(ActionMap):
    """δ = Δ · clip(Σ_j a_j B_j): sixteen fixed directions, a sign per channel times a smooth plane wave over the map.

    The directions come from a seed of their own, so an action means the same in every environment; they need no
    knowledge of the detector (black-box). Our choice: the paper has no such attack.
    """

    count = 16

    def __init__(self, channels: int, size: int) -> None:
        super().__init__((self.count,))
        rng = np.random.default_rng(0)
        signs = rng.choice([-1.0, 1.0], (self.count, channels, 1, 1))
        wave = rng.uniform(-np.pi, np.pi, (self.count, 3)) * np.array([4 / size, 4 / size, 1.0])
        row, column = np.mgrid[:size, :size]
        phase = wave[:, 0, None, None] * row + wave[:, 1, None, None] * column + wave[:, 2, None, None]
        self._directions = torch.from_numpy((signs * np.cos(phase)[:, None]).astype(np.float32))

    def __call__(self, actions: Float[np.ndarray, "E k *a"], situation: Situation) -> Float[Tensor, "E k C H W"]:
        device = situation.device
        mixed = torch.einsum("eka,achw->ekchw", torch.from_numpy(actions).to(device), self._directions.to(device))
        return project(mixed.clamp_(-1, 1).mul_(situation.budget), situation.budget, situation.norm, out=mixed)
