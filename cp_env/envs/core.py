"""The game: worlds, action maps, observations and rewards put together, E worlds × S slots at a time.

Every public environment (PettingZoo, gymnasium, vector, Stable-Baselines3) is a thin view of this one object.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from jaxtyping import Bool, Float, UInt8

from cp_env.detector.protocol import DetectorLike
from cp_env.envs.actions.registry import make_action
from cp_env.envs.observation import Observation, Observer, Seats
from cp_env.envs.reward import make_reward
from cp_env.rendering.camera import Camera
from cp_env.settings import Settings
from cp_env.types import SceneSource
from cp_env.world.scene_cache import SceneBank
from cp_env.world.situation import Outcome
from cp_env.world.world import World
from defenders.protocol import Defender

INFO_KEYS = (
    "vehicle",  # number of the vehicle the slot drives
    "liar",  # 1 if its actions count
    "excluded",  # 1 if the last verdict left it out of the fusion
    "accused",  # 1 if the last verdict suspects it
    "perturbation_norm",  # ‖δ‖ it sent
    "damage",  # 1 - Jaccard(output, clean), of the world
    "verifications",  # paid in this frame
    "similarity",  # Eq. (5) of everyone fused to the previous output
    "suspects",  # how many are accused
    "collaborators",  # how many were fused
    "converged",  # 1 if the defender is sure
    "frame",  # since the episode began
    "failed",  # 1 if the defender raised: the episode is over
)

Infos = dict[str, np.ndarray]


class Game:
    """E worlds with S slots each. Slots are adversaries, or every vehicle (`slots="vehicles"`).

    Arrays have first axes [E, S]. Nothing resets itself: a world whose step was truncated waits for `reset`.
    """

    def __init__(
        self,
        num_envs: int,
        defender: str | Defender | Callable[[], Defender] = "prbi",
        *,
        scenes: str | SceneSource = "town",
        device: str = "cpu",
        detector: str | DetectorLike = "cp_env",
        checkpoint: str | Path | None = None,
        bank: SceneBank | None = None,
        **knobs: Any,
    ) -> None:
        settings = Settings(**knobs)
        if settings.k == 0:
            raise ValueError("an environment needs at least one adversary: set n_attackers >= 1")
        self.settings, self.num_envs = settings, num_envs
        self.world = World(
            num_envs,
            defender=defender,
            scenes=scenes,
            device=device,
            detector=detector,
            checkpoint=checkpoint,
            bank=bank,
            settings=settings,
        )
        shape = (self.world.detector.channels, self.world.detector.size)
        self._map = make_action(settings.action, *shape)
        self._observer = Observer(settings, *shape)
        self._reward = make_reward(settings.reward)
        self._camera = Camera(self.world)
        self._fresh = np.ones(num_envs, dtype=bool)
        self.outcome: Outcome | None = None

    @property
    def slots(self) -> list[str]:
        """Names of the agents, the same for the whole life of the object."""
        if self.settings.slots == "vehicles":
            return [f"vehicle_{i}" for i in range(self.settings.n_maps)]
        return [f"adversary_{i}" for i in range(self.settings.k)]

    @property
    def single_action_space(self) -> gymnasium.spaces.Box:
        return self._map.space

    @property
    def single_observation_space(self) -> gymnasium.spaces.Box | gymnasium.spaces.Dict:
        return self._observer.space

    @property
    def info_keys(self) -> tuple[str, ...]:
        return INFO_KEYS

    @property
    def errors(self) -> tuple[str | None, ...]:
        """Why a world's defender failed in the last step; None where it did not."""
        return (None,) * self.num_envs if self.outcome is None else self.outcome.errors

    def reset(
        self,
        seeds: Sequence[int | np.random.SeedSequence | None] | None = None,
        worlds: Sequence[int] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Observation, Infos]:
        """Begin new episodes in `worlds` (all by default); returns observations and infos of all worlds."""
        worlds = list(range(self.num_envs) if worlds is None else worlds)
        self.world.reset(seeds, worlds, options)
        self._map.reset(worlds)
        self._camera.forget(worlds)
        self._fresh[worlds] = True
        return self._observe()

    def step(
        self, actions: Float[np.ndarray, "E S *a"]
    ) -> tuple[Observation, Float[np.ndarray, "E S"], Bool[np.ndarray, " E"], Infos]:
        """Play one frame: observations, team rewards, truncations (of worlds) and infos."""
        checked = self._map.checked(actions, (self.num_envs, len(self.slots)))
        delta = self._map(self._liars_rows(checked), self.world.situation())
        self.outcome = self.world.step(delta)
        self._camera.watch(self.outcome)
        self._fresh[:] = False
        reward = np.repeat(self._reward(self.outcome)[:, None], len(self.slots), axis=1).astype(np.float32)
        observation, infos = self._observe()
        return observation, reward, self.outcome.truncated, infos

    def state(self, world: int = 0) -> Float[np.ndarray, "N C H W"]:
        """Every vehicle's encoded map, for centralised critics and joint attackers."""
        episode, frame = self.world.places[world]
        return episode.maps("features", frame).numpy()

    def render(self, world: int = 0) -> UInt8[np.ndarray, "h w 3"]:
        """The picture of a world's last frame (see `cp_env.rendering.frame`)."""
        return self._camera.shoot(world)

    def _seats(self) -> Seats:
        attackers = self.world.attackers
        if self.settings.slots == "adversaries":
            return Seats(attackers, np.ones_like(attackers, dtype=bool))
        vehicle = np.tile(np.arange(self.settings.n_maps), (self.num_envs, 1))
        return Seats(vehicle, (vehicle[..., None] == attackers[:, None]).any(-1))

    def _liars_rows(self, actions: Float[np.ndarray, "E S *a"]) -> Float[np.ndarray, "E k *a"]:
        """The liars' actions, in the order of `world.attackers`; those of honest vehicles do nothing."""
        if self.settings.slots == "adversaries":
            return actions
        return np.stack([rows[liars] for rows, liars in zip(actions, self.world.attackers, strict=True)])

    def _observe(self) -> tuple[Observation, Infos]:
        seats = self._seats()
        return self._observer(self.world, seats, self.outcome, self._fresh), self._infos(seats)

    def _infos(self, seats: Seats) -> Infos:
        """Numbers only, constant keys, each [E, S]. In a world that was just reset the frame's figures are neutral."""
        infos = {key: np.zeros(seats.vehicle.shape, dtype=np.float32) for key in INFO_KEYS}
        infos["vehicle"][:] = seats.vehicle
        infos["liar"][:] = seats.liar
        infos["similarity"][:] = 1.0
        infos["collaborators"][:] = self.settings.n_maps
        if self.outcome is None:
            return infos
        outcome = self.outcome
        for e in np.flatnonzero(~self._fresh):
            verdict = outcome.verdicts[e]
            infos["excluded"][e] = [v not in verdict.collaborators for v in seats.vehicle[e]]
            infos["accused"][e] = [v in verdict.suspects for v in seats.vehicle[e]]
            infos["perturbation_norm"][e, seats.liar[e]] = outcome.perturbation_norm[e]
            infos["suspects"][e] = len(verdict.suspects)
            infos["collaborators"][e] = len(verdict.collaborators)
            infos["converged"][e] = verdict.converged
            infos["failed"][e] = outcome.errors[e] is not None
            for key in ("damage", "verifications", "similarity", "frame"):
                infos[key][e] = getattr(outcome, key)[e]
        return infos
