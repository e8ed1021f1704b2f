"""Playing an environment and comparing what it returned: the tools the rules are written with."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any

import numpy as np
from gymnasium import Space

Env = Any  # a PettingZoo ParallelEnv; any class with its methods will do


class Violation(AssertionError):
    """A rule does not hold. The suite adds the rule's name."""


def require(condition: bool | np.bool_, message: str) -> None:
    """Raise a `Violation` with this message unless the condition holds."""
    if not condition:
        raise Violation(message)


@dataclass(frozen=True, eq=False)
class Call:
    """What one `reset` or `step` returned. A reset has no rewards, terminations and truncations."""

    name: str  # "reset" | "step"
    observations: dict[str, Any]
    infos: dict[str, dict[str, Any]]
    rewards: dict[str, Any] = field(default_factory=dict)
    terminations: dict[str, Any] = field(default_factory=dict)
    truncations: dict[str, Any] = field(default_factory=dict)

    @property
    def dicts(self) -> dict[str, dict[str, Any]]:
        """The dicts that were returned, by name."""
        kept = fields(self)[1:] if self.name == "step" else fields(self)[1:3]
        return {one.name: getattr(self, one.name) for one in kept}

    def snapshot(self) -> Call:
        """A deep copy, safe from whatever the environment does next."""
        return copy.deepcopy(self)


class Player:
    """Plays one environment with random actions of its own, so that two players of one seed act the same."""

    def __init__(self, env: Env, seed: int) -> None:
        self.env = env
        self.spaces: dict[str, Space[Any]] = {
            agent: copy.deepcopy(env.action_space(agent)) for agent in env.possible_agents
        }
        for offset, space in enumerate(self.spaces.values()):
            space.seed(seed + offset)
        self.last: Call | None = None

    def reset(self, seed: int | None = None) -> Call:
        """Reset the environment."""
        self.last = Call("reset", *self.env.reset(seed=seed))
        return self.last

    def actions(self) -> dict[str, Any]:
        """One random action for every living agent; masked where the observation or info holds an `action_mask`."""
        assert self.last is not None
        return {agent: self.spaces[agent].sample(self._mask(agent, self.last)) for agent in self.env.agents}

    def step(self, actions: dict[str, Any] | None = None) -> Call:
        """One step, with random actions unless some are given."""
        observations, rewards, terminations, truncations, infos = self.env.step(
            self.actions() if actions is None else actions
        )
        self.last = Call("step", observations, infos, rewards, terminations, truncations)
        return self.last

    def advance(self) -> Call:
        """One step, or a reset without a seed when the episode is over."""
        return self.step() if self.env.agents else self.reset()

    def play(self, calls: int) -> list[Call]:
        """Snapshots of so many calls of `advance`."""
        return [self.advance().snapshot() for _ in range(calls)]

    @staticmethod
    def _mask(agent: str, call: Call) -> Any:
        for holder in (call.observations[agent], call.infos.get(agent, {})):
            if isinstance(holder, dict) and "action_mask" in holder:
                return holder["action_mask"]
        return None


@dataclass(eq=False)
class Case:
    """What a rule is checked on: how to make an environment (each an independent instance), how long, which seed."""

    make: Callable[[], Env]
    steps: int
    seed: int

    def player(self) -> Player:
        """A fresh instance and a player of it. Players of one case act the same."""
        return Player(self.make(), self.seed)

    def transcript(self, seed: int) -> list[Call]:
        """A fresh instance reset with this seed and played for `steps` calls, over the end of an episode if need be."""
        player = self.player()
        return [player.reset(seed).snapshot(), *player.play(self.steps)]

    @cached_property
    def calls(self) -> list[Call]:
        """The transcript of the case's own seed."""
        return self.transcript(self.seed)

    @cached_property
    def other_calls(self) -> list[Call]:
        """The transcript of the seed after it."""
        return self.transcript(self.seed + 1)


def difference(a: Any, b: Any, where: str = "") -> str | None:
    """Where two returned things differ first, bit for bit and type for type; None if they are the same."""
    if type(a) is not type(b):
        return f"{where} is a {type(a).__name__} here, a {type(b).__name__} there"
    if isinstance(a, Call):
        return difference({"call": a.name, **a.dicts}, {"call": b.name, **b.dicts}, where)
    if isinstance(a, dict):
        if a.keys() != b.keys():
            return f"{where} has the keys {sorted(map(str, a))} here, {sorted(map(str, b))} there"
        return _first(difference(a[key], b[key], f"{where}[{key!r}]") for key in a)
    if isinstance(a, list | tuple):
        if len(a) != len(b):
            return f"{where} has {len(a)} items here, {len(b)} there"
        return _first(difference(x, y, f"{where}[{i}]") for i, (x, y) in enumerate(zip(a, b, strict=True)))
    if isinstance(a, np.ndarray):
        if a.dtype != b.dtype or a.shape != b.shape:
            return f"{where} is {a.dtype}{list(a.shape)} here, {b.dtype}{list(b.shape)} there"
        if a.dtype == object:
            return difference(a.tolist(), b.tolist(), where)
        same = a.tobytes() == b.tobytes() or np.array_equal(a, b, equal_nan=a.dtype.kind in "fc")
        return None if same else f"{where} differs in {int(np.sum(a != b))} of {a.size} entries"
    return None if a == b or (a != a and b != b) else f"{where} is {a!r} here, {b!r} there"


def _first(differences: Iterator[str | None]) -> str | None:
    return next((found for found in differences if found is not None), None)


def arrays(data: Any) -> Iterator[np.ndarray]:
    """Every array in nested dicts, lists and tuples."""
    if isinstance(data, np.ndarray):
        yield data
    elif isinstance(data, dict):
        for part in data.values():
            yield from arrays(part)
    elif isinstance(data, list | tuple):
        for part in data:
            yield from arrays(part)
