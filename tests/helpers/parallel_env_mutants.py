"""Environments that break one of the rules for any `ParallelEnv` each."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
from gymnasium import spaces

from tests.helpers.lawful_env import Lawful, breaks


@breaks("spaces_are_fixed")
class NewSpaces(Lawful):
    def action_space(self, agent: str) -> spaces.Space[Any]:
        return spaces.Box(-1.0, 1.0, (2,), np.float32)


@breaks("agents_are_constant")
class NeverEmpty(Lawful):
    def step(self, actions: dict[str, np.ndarray]) -> Any:
        returned = super().step(actions)
        self.agents = self.possible_agents[:]
        return returned


@breaks("agents_are_constant")
class OneDrops(Lawful):
    def reset(self, seed: int | None = None, options: Any = None) -> Any:
        returned = super().reset(seed)
        self.agents = self.agents[:1]
        return returned


@breaks("dicts_are_complete")
class OneReward(Lawful):
    def rewards(self) -> dict[str, float]:
        return {"adversary_0": 1.0}


@breaks("dicts_are_complete")
class CommonInfo(Lawful):
    def infos(self) -> dict[str, dict[str, Any]]:
        return {**super().infos(), "common": {}}


@breaks("observations_have_their_type")
class NarrowObservation(Lawful):  # a float16 array is `contained` in a float32 Box
    def observe(self) -> dict[str, np.ndarray]:
        return {key: value.astype(np.float16) for key, value in super().observe().items()}


@breaks("observations_have_their_type")
class LostKey(Lawful):
    def observe(self) -> dict[str, np.ndarray]:
        return {"place": super().observe()["place"]}


@breaks("observations_have_their_type")
class ShortObservation(Lawful):
    def observe(self) -> dict[str, np.ndarray]:
        return {key: value[:1] for key, value in super().observe().items()}


@breaks("observations_are_contained")
class LateObservation(Lawful):
    def observe(self) -> dict[str, np.ndarray]:
        return {**super().observe(), "clock": np.array([0.5 * self.frame], dtype=np.float32)}


@breaks("observations_are_contained")
class NanObservation(Lawful):  # in a Box: NaN is inside no interval
    def observe(self) -> dict[str, np.ndarray]:
        return {**super().observe(), "clock": np.array([np.nan], dtype=np.float32)}


@breaks("observations_are_finite")
class InfiniteObservation(Lawful):
    def __init__(self) -> None:
        super().__init__()
        for space in self._seen.values():
            space["clock"] = spaces.Box(-np.inf, np.inf, (1,), np.float32)  # which contains infinity

    def observe(self) -> dict[str, np.ndarray]:
        return {**super().observe(), "clock": np.array([np.inf], dtype=np.float32)}


@breaks("infos_are_numbers")
class WordyInfo(Lawful):
    def infos(self) -> dict[str, dict[str, Any]]:
        return {agent: {**info, "scene": "urban"} for agent, info in super().infos().items()}


@breaks("infos_are_numbers")
class ArrayInfo(Lawful):
    def infos(self) -> dict[str, dict[str, Any]]:
        return {agent: {**info, "target": self.target.copy()} for agent, info in super().infos().items()}


@breaks("infos_are_numbers")
class NanInfo(Lawful):
    def infos(self) -> dict[str, dict[str, Any]]:
        return {agent: {**info, "similarity": float("nan")} for agent, info in super().infos().items()}


@breaks("infos_are_numbers")
class GrowingInfo(Lawful):
    def infos(self) -> dict[str, dict[str, Any]]:
        late = {"late": 1.0} if self.frame else {}
        return {agent: {**info, **late} for agent, info in super().infos().items()}


@breaks("infos_are_numbers")
class FickleInfo(Lawful):
    def infos(self) -> dict[str, dict[str, Any]]:
        kind = float if self.frame == 2 else int
        return {agent: {**info, "frame": kind(self.frame)} for agent, info in super().infos().items()}


@breaks("rewards_are_floats")
class IntegerRewards(Lawful):
    def rewards(self) -> Any:
        return dict.fromkeys(self.possible_agents, 1)


@breaks("rewards_are_floats")
class InfiniteRewards(Lawful):
    def rewards(self) -> Any:
        return dict.fromkeys(self.possible_agents, float("inf"))


@breaks("flags_are_bools")
class NumpyFlags(Lawful):
    def flags(self, value: bool) -> Any:
        return dict.fromkeys(self.possible_agents, np.bool_(value))


@breaks("same_seed_same_trajectory")
class GlobalNoise(Lawful):
    count = itertools.count()

    def rewards(self) -> dict[str, float]:
        return dict.fromkeys(self.possible_agents, float(next(self.count)))


@breaks("same_seed_same_trajectory")
class DrawnBeforeSeeding(Lawful):  # the first observation ignores the seed, the rest obeys it
    def reset(self, seed: int | None = None, options: Any = None) -> Any:
        stale = self.rng.uniform(-1, 1, 3).astype(np.float32)
        observations, infos = super().reset(seed)
        for one in observations.values():
            one["place"] = stale.copy()
        return observations, infos


@breaks("same_seed_same_trajectory")
class RemembersTheLastEpisode(Lawful):
    episodes = 0

    def reset(self, seed: int | None = None, options: Any = None) -> Any:
        returned = super().reset(seed)
        self.episodes += 1
        for one in returned[0].values():
            one["place"] += np.float32(0.01 * self.episodes)
        return returned


@breaks("seeds_differ")
class DeafToSeeds(Lawful):
    def reset(self, seed: int | None = None, options: Any = None) -> Any:
        return super().reset(None if seed is None else 0)


@breaks("stream_goes_on")
class AlwaysTheSame(Lawful):
    seed = 0

    def reset(self, seed: int | None = None, options: Any = None) -> Any:
        self.seed = self.seed if seed is None else seed
        return super().reset(self.seed)


@breaks("stream_goes_on")
class StreamLost(Lawful):  # reset() without a seed draws from the operating system
    def reset(self, seed: int | None = None, options: Any = None) -> Any:
        first = not hasattr(self, "frame")
        fresh = np.random.SeedSequence().entropy if seed is None and not first and self.frame == 0 else seed
        return super().reset(fresh)


@breaks("instances_are_independent")
class SharedTarget(Lawful):
    shared: dict[str, Any] = {}  # noqa: RUF012

    def reset(self, seed: int | None = None, options: Any = None) -> Any:
        returned = super().reset(seed)
        self.shared["target"] = self.target
        return returned

    def step(self, actions: Any) -> Any:
        self.target = self.shared.get("target", None) if self.agents else None
        returned = super().step(actions)
        self.shared["target"] = self.target
        return returned


@breaks("pickling_changes_nothing")
class ForgetsItsStream(Lawful):
    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "rng": np.random.default_rng(0)}


@breaks("pickling_changes_nothing")
class Unpicklable(Lawful):
    def __init__(self) -> None:
        super().__init__()
        self.hook = lambda: None


@breaks("nothing_is_shared")
class ReusedBuffer(Lawful):
    def reset(self, seed: int | None = None, options: Any = None) -> Any:
        self.buffer = np.zeros((2, 3), dtype=np.float32)
        return super().reset(seed)

    def observations(self) -> dict[str, dict[str, np.ndarray]]:
        self.buffer[:] = self.target
        rows = zip(self.possible_agents, self.buffer, strict=True)
        return {agent: {**self.observe(), "place": row} for agent, row in rows}


@breaks("nothing_is_shared")
class OneForAll(Lawful):
    def observations(self) -> dict[str, dict[str, np.ndarray]]:
        return dict.fromkeys(self.possible_agents, self.observe())


@breaks("nothing_is_shared")
class OldInfos(Lawful):
    kept: Any = None

    def infos(self) -> dict[str, dict[str, Any]]:
        self.kept = self.kept or {agent: {} for agent in self.possible_agents}
        for agent, info in super().infos().items():
            self.kept[agent].update(info)
        return dict(self.kept)


@breaks("scribbling_is_harmless")
class InnermostState(Lawful):
    def state(self) -> np.ndarray:
        return self.target


@breaks("scribbling_is_harmless")
class ClipsInPlace(Lawful):
    def checked(self, actions: Any) -> np.ndarray:
        checked = super().checked(actions)
        for action in actions.values():
            np.clip(action, -0.5, 0.5, out=action)
        return checked


@breaks("scribbling_is_harmless")
class ActsLater(Lawful):  # keeps the action by reference and uses it in the next frame
    pending: Any = None

    def reset(self, seed: int | None = None, options: Any = None) -> Any:
        self.pending = None
        return super().reset(seed)

    def checked(self, actions: Any) -> np.ndarray:
        now = super().checked(actions)
        late = now if self.pending is None else super().checked(self.pending)
        self.pending = dict(actions)
        return late


@breaks("state_is_constant")
class GrowingState(Lawful):
    def state(self) -> np.ndarray:
        return np.zeros(3 + self.frame, dtype=np.float32)


@breaks("state_is_constant")
class DrawnState(Lawful):
    def state(self) -> np.ndarray:
        return super().state() + np.float32(self.rng.normal())


@breaks("state_is_constant")
class StateOutOfItsSpace(Lawful):
    def state(self) -> np.ndarray:
        return super().state() + np.float32(100)


@breaks("rendering_changes_nothing")
class FloatPicture(Lawful):
    def render(self) -> np.ndarray:
        return super().render().astype(np.float32)


@breaks("rendering_changes_nothing")
class DrawnWithTheWorldsDice(Lawful):
    def render(self) -> np.ndarray:
        self.rng.normal()
        return super().render()
