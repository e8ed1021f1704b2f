"""The batched environment: worlds, action maps, observations and rewards of E worlds × S slots.

Every public environment (PettingZoo, gymnasium, vector, Stable-Baselines3) is a thin view of this one object.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Unpack

import gymnasium
import numpy as np
from jaxtyping import Bool, Float, UInt8

from cp_env.envs.actions.registry import make_action
from cp_env.envs.observation import Observation, Observer, SlotAssignment
from cp_env.envs.reward import make_reward
from cp_env.rendering.camera import Camera
from cp_env.settings import Options
from cp_env.world.counterfactual import rounded
from cp_env.world.reset import ResetOptions, Seed
from cp_env.world.scene_cache import SceneBank
from cp_env.world.situation import FRAME_METRICS, Clock, Outcome
from cp_env.world.streams import PUBLIC_KEY
from cp_env.world.world import World
from defenders.protocol import Defender

INFO_KEYS = (
    "vehicle",  # number of the vehicle the slot drives
    "malicious",  # 1 if the vehicle is an attacker: its actions count
    "excluded",  # 1 if the last verdict left it out of the fusion
    "flagged",  # 1 if the last verdict names it a suspect
    "perturbation_norm",  # ‖δ‖ it sent
    "damage",  # 1 - Jaccard(output, clean), of the world
    "verifications",  # paid in this frame
    "similarity",  # Eq. (5) of everyone fused to the previous output
    "suspects",  # how many are flagged
    "collaborators",  # how many were fused
    "converged",  # 1 if the defender has converged
    "frame",  # since the episode began
    "failed",  # 1 if the defender raised: the episode is over
    "decodes",  # groups that were perceived in this frame
    "critical",  # vehicles that matter for the ego's driving: near in its corridor, or soon to be hit
    "critical_missed",  # how many of them the output misses
    "miss_severity",  # m/s²: the hardest braking that a missed vehicle demands
    "ghost_severity",  # m/s²: the hardest braking that a ghost demands
    "removed",  # 1 if the output misses the nearest vehicle, which the clean view finds
    "spoofed",  # 1 if the output holds a critical ghost that the clean view does not hold
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
        bank: SceneBank | None = None,
        clock: Clock = time.perf_counter,
        key: str = PUBLIC_KEY,
        **options: Unpack[Options],
    ) -> None:
        self.world = World(num_envs, defender=defender, bank=bank, clock=clock, key=key, **options)
        self.settings, self.num_envs = self.world.settings, num_envs
        settings = self.settings
        if settings.k == 0:
            raise ValueError("an environment needs at least one adversary: set n_attackers >= 1")
        shape = (self.world.detector.channels, self.world.detector.size)
        self._map = make_action(settings.action, *shape, settings.gradient_precision)
        if settings.gradient_precision is not None:
            rounded(self.world.detector, settings.gradient_precision)
        self._observer = Observer(settings, *shape)
        self._reward = make_reward(settings.reward)
        self._camera = Camera(self.world, f"{settings.action} actions")
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
        seeds: Sequence[Seed] | None = None,
        worlds: Sequence[int] | None = None,
        options: ResetOptions = None,
    ) -> tuple[Observation, Infos]:
        """Begin new episodes in `worlds` (all by default); returns observations and infos of all worlds."""
        worlds = list(range(self.num_envs) if worlds is None else worlds)
        self.world.reset(seeds, worlds, options)
        self._map.reset(worlds)
        self._camera.reset(worlds)
        self._fresh[worlds] = True
        return self._observe()

    def step(
        self, actions: Float[np.ndarray, "E S *a"]
    ) -> tuple[Observation, Float[np.ndarray, "E S"], Bool[np.ndarray, " E"], Infos]:
        """Play one frame: observations, team rewards, truncations (of worlds) and infos."""
        checked = self._map.checked(actions, (self.num_envs, len(self.slots)))
        delta = self._map(self._attacker_rows(checked), self.world.current())
        self.outcome = self.world.step(delta)
        self._camera.record(self.outcome)
        self._fresh[:] = False
        reward = np.repeat(self._reward(self.outcome)[:, None], len(self.slots), axis=1).astype(np.float32)
        observation, infos = self._observe()
        return observation, reward, self.outcome.truncated, infos

    @property
    def state_space(self) -> gymnasium.spaces.Box:
        """The space of `state`."""
        return self._observer.state_space

    def state(self, world: int = 0) -> Float[np.ndarray, "..."]:
        """The central state of one world, for critics and joint attacks.

        Args:
            world: its number.

        Returns:
            Every vehicle's encoded map [N, C, H, W] in its own grid frame, or with `state="compact"` one vector whose
            entries `cp_env.envs.observation.state_names` names.
        """
        return self._observer.state(self.world, world, self.outcome, self._fresh)

    def render(self, world: int = 0) -> UInt8[np.ndarray, "h w 3"]:
        """The picture of a world's last frame (see `cp_env.rendering.frame`)."""
        return self._camera.render(world)

    def _slot_assignment(self) -> SlotAssignment:
        attackers = self.world.attackers
        if self.settings.slots == "adversaries":
            return SlotAssignment(attackers, np.ones_like(attackers, dtype=bool))
        vehicle = np.tile(np.arange(self.settings.n_maps), (self.num_envs, 1))
        return SlotAssignment(vehicle, (vehicle[..., None] == attackers[:, None]).any(-1))

    def _attacker_rows(self, actions: Float[np.ndarray, "E S *a"]) -> Float[np.ndarray, "E k *a"]:
        """The attackers' actions, in the order of `world.attackers`; those of benign vehicles do nothing."""
        if self.settings.slots == "adversaries":
            return actions
        return np.stack([rows[attackers] for rows, attackers in zip(actions, self.world.attackers, strict=True)])

    def _observe(self) -> tuple[Observation, Infos]:
        slots = self._slot_assignment()
        return self._observer(self.world, slots, self.outcome, self._fresh), self._infos(slots)

    def _infos(self, slots: SlotAssignment) -> Infos:
        """Numbers only, constant keys, each [E, S]. In a world that was just reset the frame's figures are neutral."""
        infos = {key: np.zeros(slots.vehicle.shape, dtype=np.float32) for key in INFO_KEYS}
        infos["vehicle"][:] = slots.vehicle
        infos["malicious"][:] = slots.malicious
        infos["similarity"][:] = 1.0
        infos["collaborators"][:] = self.settings.n_maps
        if self.outcome is None:
            return infos
        outcome, played = self.outcome, ~self._fresh
        for key, metric in FRAME_METRICS.items():
            infos[key][played] = metric(outcome)[played, None]
        verdicts = outcome.verdicts
        for e in np.flatnonzero(played).tolist():
            verdict = verdicts[e]
            infos["excluded"][e] = [v not in verdict.collaborators for v in slots.vehicle[e]]
            infos["flagged"][e] = [v in verdict.suspects for v in slots.vehicle[e]]
            infos["perturbation_norm"][e, slots.malicious[e]] = outcome.perturbation_norm[e]
        return infos
