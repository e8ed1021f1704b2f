"""What a slot observes: its own encoded map and a context vector, or one compact vector.

The entries of the context are a table: `cp_env.envs.context`. All of them lie in [-1, 1].
"""

from __future__ import annotations

from typing import Any
from weakref import WeakKeyDictionary

import gymnasium
import numpy as np
import torch
from jaxtyping import Bool, Float

from cp_env.envs.context import (
    POOL,
    Moment,
    SlotAssignment,
    columns_of,
    context_names,
    pooled,
    read_context,
)
from cp_env.settings import Settings
from cp_env.world.episode import Episode
from cp_env.world.situation import Outcome
from cp_env.world.world import World

__all__ = ["LARGEST", "Observation", "Observer", "SlotAssignment", "context_names", "state_names"]

Observation = np.ndarray | dict[str, np.ndarray]

LARGEST = float(np.finfo(np.float16).max)
"""No feature is larger: maps are kept in half precision."""


class Observer:
    """Builds every slot's observation from the world before the frame and the outcome of the last one."""

    def __init__(self, settings: Settings, channels: int, size: int) -> None:
        self.settings, self._shape = settings, (channels, size, size)
        self._energy: WeakKeyDictionary[Episode, dict[int, np.ndarray]] = WeakKeyDictionary()
        self.context_size = len(context_names(settings.knowledge, settings.n_maps))
        context = gymnasium.spaces.Box(-1.0, 1.0, (self.context_size,), np.float32)
        self.space: gymnasium.spaces.Box | gymnasium.spaces.Dict = (
            gymnasium.spaces.Dict(
                features=gymnasium.spaces.Box(-LARGEST, LARGEST, self._shape, np.float32), context=context
            )
            if settings.observation == "features"
            else gymnasium.spaces.Box(-1.0, 1.0, (self.context_size + POOL**2,), np.float32)
        )

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "_energy"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state, _energy=WeakKeyDictionary())  # computed again

    def __call__(
        self, world: World, slots: SlotAssignment, last: Outcome | None, fresh: Bool[np.ndarray, " E"]
    ) -> Observation:
        """Every slot's observation, first axes [E, S]. In `fresh` worlds the episode just began: no `last` there."""
        context = read_context(columns_of(self.settings.knowledge), Moment(world, slots, last, fresh))
        if self.settings.observation == "features":
            maps = world.features()
            own = maps[torch.arange(len(maps))[:, None], torch.from_numpy(slots.vehicle)]
            return {"features": own.float().cpu().numpy(), "context": context}
        energy = np.stack([self._energies(*place) for place in world.places])
        own_energy = np.take_along_axis(energy, slots.vehicle[..., None], axis=1)
        return np.concatenate([context, own_energy], axis=-1).astype(np.float32)

    def _energies(self, episode: Episode, frame: int) -> Float[np.ndarray, "N cells"]:
        """The mean feature of every vehicle's map on a coarse grid, squashed to [-1, 1]: computed once for a frame."""
        known = self._energy.setdefault(episode, {})
        if frame not in known:
            known[frame] = np.tanh(pooled(episode.maps("features", frame)[None].mean(2)))[0]
        return known[frame]

    @property
    def state_space(self) -> gymnasium.spaces.Box:
        """The space of one world's central state."""
        settings = self.settings
        if settings.state == "maps":
            return gymnasium.spaces.Box(-LARGEST, LARGEST, (settings.n_maps, *self._shape), np.float32)
        return gymnasium.spaces.Box(-1.0, 1.0, (len(state_names(settings.n_maps)),), np.float32)

    def state(
        self, world: World, e: int, last: Outcome | None, fresh: Bool[np.ndarray, " E"]
    ) -> Float[np.ndarray, "..."]:
        """The central state of world `e`, for critics: every vehicle's map, or one vector of `state_names`."""
        episode, frame = world.places[e]
        if self.settings.state == "maps":
            return episode.maps("features", frame).numpy()
        n = self.settings.n_maps
        vehicle = np.tile(np.arange(n), (world.num_envs, 1))
        slots = SlotAssignment(vehicle, (vehicle[..., None] == world.attackers[:, None]).any(-1))
        moment = Moment(world, slots, last, fresh)
        columns = [column for column in columns_of("white-box") if column.name != "own"]
        own, team = ([column for column in columns if column.shared == one] for one in (False, True))
        each = np.concatenate([read_context(own, moment)[e], self._energies(episode, frame)], axis=-1)
        return np.concatenate([each.ravel(), read_context(team, moment)[e, 0]]).astype(np.float32)


def state_names(n_maps: int = 5) -> tuple[str, ...]:
    """The name of every entry of the compact central state: each vehicle's own entries, then those of the world."""
    own = [c.name for c in columns_of("white-box") if c.name != "own" and not c.shared]
    own += [f"energy_{i}" for i in range(POOL**2)]
    team = [name for c in columns_of("white-box") if c.shared for name in c.names(n_maps)]
    return (*(f"vehicle_{i}.{name}" for i in range(n_maps) for name in own), *team)
