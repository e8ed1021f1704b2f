"""What a slot sees: its own encoded map and a context vector, or one compact vector.

`knowledge` says how much of the defence the context shows:
    black-box   the slot's own role, place and last lie, and the clock.
    gray-box    also what the ego's output gave away: similarity, damage, verifications, whom it fused.
    white-box   also the defender's belief, its suspects, who else lies, and the clean score map.
All context numbers lie in [-1, 1].
"""

from __future__ import annotations

from dataclasses import dataclass

import gymnasium
import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn import functional

from cp_env.settings import KNOWLEDGE, Settings
from cp_env.world.situation import Outcome
from cp_env.world.verification import suspicion
from cp_env.world.world import World

Observation = np.ndarray | dict[str, np.ndarray]

POOL = 4
"""Side of the coarse grids in compact vectors."""

SCALE = 64.0
"""Metres that count as 1 in a context."""

LARGEST = float(np.finfo(np.float16).max)
"""No feature is larger: maps are kept in half precision."""

MOST_VERIFICATIONS = 8.0
"""Verifications that count as 1 in a context: PRBI's most at n = 5."""


@dataclass(frozen=True, eq=False)
class Seats:
    """Which vehicle every slot drives, and whether it may lie."""

    vehicle: Int[np.ndarray, "E S"]
    liar: Bool[np.ndarray, "E S"]


class Observer:
    """Builds every slot's observation from the world before the frame and the outcome of the last one."""

    def __init__(self, settings: Settings, channels: int, size: int) -> None:
        self.settings, self._shape = settings, (channels, size, size)
        self._level = KNOWLEDGE.index(settings.knowledge)
        self.context_size = 9 + 6 * (self._level >= 1) + (4 * settings.n_maps + POOL**2) * (self._level >= 2)
        context = gymnasium.spaces.Box(-1.0, 1.0, (self.context_size,), np.float32)
        self.space: gymnasium.spaces.Box | gymnasium.spaces.Dict = (
            gymnasium.spaces.Dict(
                features=gymnasium.spaces.Box(-LARGEST, LARGEST, self._shape, np.float32), context=context
            )
            if settings.observation == "features"
            else gymnasium.spaces.Box(-1.0, 1.0, (self.context_size + POOL**2,), np.float32)
        )

    def __call__(self, world: World, seats: Seats, last: Outcome | None, fresh: Bool[np.ndarray, " E"]) -> Observation:
        """Every slot's observation, first axes [E, S]. In `fresh` worlds the episode just began: no `last` there."""
        context = np.clip(self._context(world, seats, last, fresh), -1.0, 1.0).astype(np.float32)
        maps = world.features()
        own = maps[torch.arange(len(maps))[:, None], torch.from_numpy(seats.vehicle)]
        if self.settings.observation == "features":
            return {"features": own.cpu().numpy(), "context": context}
        energy = np.tanh(_pooled(own.mean(2)))
        return np.concatenate([context, energy], axis=-1).astype(np.float32)

    def _context(
        self, world: World, seats: Seats, last: Outcome | None, fresh: Bool[np.ndarray, " E"]
    ) -> Float[np.ndarray, "E S c"]:
        parts = [self._role(world, seats, last, fresh)]
        if self._level >= 1:
            parts.append(self._feedback(world, seats, last, fresh))
        if self._level >= 2:
            parts.append(self._insight(world, seats, last, fresh))
        return np.concatenate(parts, axis=-1)

    def _role(
        self, world: World, seats: Seats, last: Outcome | None, fresh: Bool[np.ndarray, " E"]
    ) -> Float[np.ndarray, "E S 9"]:
        settings, situation = self.settings, world.situation()
        pose = np.take_along_axis(situation.ego_T_sender.cpu().numpy(), seats.vehicle[..., None], axis=1)
        active = situation.active.cpu().numpy()
        columns = [
            seats.liar,
            seats.vehicle == 0,
            np.take_along_axis(world.excluded, seats.vehicle, axis=1),
            seats.vehicle / settings.n_maps,
            pose[..., 0] / SCALE,
            pose[..., 1] / SCALE,
            np.broadcast_to((situation.frame / settings.max_frames)[:, None], seats.vehicle.shape),
            np.broadcast_to(active[:, None], seats.vehicle.shape),
            _own_norm(seats, last, fresh) / max(settings.budget, 1e-9),
        ]
        return np.stack([np.asarray(column, dtype=np.float32) for column in columns], axis=-1)

    def _feedback(
        self, world: World, seats: Seats, last: Outcome | None, fresh: Bool[np.ndarray, " E"]
    ) -> Float[np.ndarray, "E S 6"]:
        told = np.zeros((world.num_envs, 6), dtype=np.float32)
        told[:, 0] = 1.0  # before the first frame the output agrees with itself
        if last is not None:
            n = self.settings.n_maps
            rows = [
                [
                    s,
                    d,
                    v / MOST_VERIFICATIONS,
                    len(verdict.suspects) / n,
                    len(verdict.collaborators) / n,
                    verdict.converged,
                ]
                for s, d, v, verdict in zip(
                    last.similarity, last.damage, last.verifications, last.verdicts, strict=True
                )
            ]
            told[~fresh] = np.array(rows, dtype=np.float32)[~fresh]
        return np.repeat(told[:, None], seats.vehicle.shape[1], axis=1)

    def _insight(
        self, world: World, seats: Seats, last: Outcome | None, fresh: Bool[np.ndarray, " E"]
    ) -> Float[np.ndarray, "E S w"]:
        n = self.settings.n_maps
        liars = np.zeros((world.num_envs, n), dtype=np.float32)
        np.put_along_axis(liars, world.attackers, 1.0, axis=1)
        belief = np.stack([suspicion(defender, n) for defender in world.defenders])
        suspects = np.zeros((world.num_envs, n), dtype=np.float32)
        if last is not None:
            for e in np.flatnonzero(~fresh):
                suspects[e, sorted(last.verdicts[e].suspects)] = 1.0
        own = np.eye(n, dtype=np.float32)[seats.vehicle]
        scene = _pooled(world.situation().clean.scores[:, None])[:, 0] * POOL**2
        shared = np.concatenate([liars, belief, suspects, scene], axis=1)
        return np.concatenate([own, np.repeat(shared[:, None], seats.vehicle.shape[1], axis=1)], axis=-1)


def _own_norm(seats: Seats, last: Outcome | None, fresh: Bool[np.ndarray, " E"]) -> Float[np.ndarray, "E S"]:
    """‖δ‖ that each slot sent in the last frame; 0 for the honest and for episodes that just began."""
    norms = np.zeros(seats.vehicle.shape, dtype=np.float32)
    if last is not None:
        norms[seats.liar] = last.perturbation_norm.ravel()
        norms[fresh] = 0.0
    return norms


def _pooled(maps: Float[Tensor, "E S H W"]) -> Float[np.ndarray, "E S p"]:
    """Means over a coarse grid, flattened."""
    pooled: np.ndarray = functional.adaptive_avg_pool2d(maps, POOL).flatten(2).cpu().numpy()
    return pooled
