"""Environments that break one of our own rules each."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from gymnasium import spaces

from tests.helpers.lawful_env import Lawful, breaks


@breaks("ball_holds")
class OverBudget(Lawful):
    def checked(self, actions: Any) -> np.ndarray:
        return np.where(np.abs(super().checked(actions)) == 1, 3.0, 0.0)

    def step(self, actions: Any) -> Any:
        returned = super().step(actions)
        self.norms = [2 * norm for norm in self.norms]
        return (*returned[:4], self.infos())


@breaks("ball_holds")
class Powerless(Lawful):
    def checked(self, actions: Any) -> np.ndarray:
        return 0 * super().checked(actions)


@breaks("out_of_range_is_clipped")
class Wraps(Lawful):
    def checked(self, actions: Any) -> np.ndarray:
        return (super().checked(actions) + 1) % 2.0000001 - 1


@breaks("bad_actions_are_refused")
class SwallowsNan(Lawful):
    def checked(self, actions: Any) -> np.ndarray:
        return super().checked({agent: np.nan_to_num(action) for agent, action in actions.items()})


@breaks("bad_actions_are_refused")
class SwallowsStrangers(Lawful):
    def checked(self, actions: Any) -> np.ndarray:
        return super().checked({agent: actions[agent] for agent in self.possible_agents if agent in actions})


@breaks("bad_actions_are_refused")
class WrongError(Lawful):
    def checked(self, actions: Any) -> np.ndarray:
        try:
            return super().checked(actions)
        except ValueError as error:
            raise AssertionError from error


@breaks("bad_actions_are_refused")
class RefusesTooLate(Lawful):
    def checked(self, actions: Any) -> np.ndarray:
        self.frame += 1
        checked = super().checked(actions)
        self.frame -= 1
        return checked


@breaks("unknown_agents_are_refused")
class KeyErrors(Lawful):
    def known(self, agent: str) -> str:
        return {name: name for name in self.possible_agents}[agent]


@breaks("unknown_agents_are_refused")
class AnyAgentWillDo(Lawful):
    def known(self, agent: str) -> str:
        return agent if agent in self.possible_agents else self.possible_agents[0]


@breaks("victim_is_frozen")
class LearningVictim(Lawful):
    def checked(self, actions: Any) -> np.ndarray:
        checked = super().checked(actions)
        self.detector[0].weight += 1e-7
        return checked


@breaks("victim_is_frozen")
class CountingVictim(Lawful):  # batch statistics are buffers
    def checked(self, actions: Any) -> np.ndarray:
        checked = super().checked(actions)
        self.detector[1].running_mean += 1e-7
        return checked


@breaks("victim_is_frozen")
class TrainingVictim(Lawful):
    def __init__(self) -> None:
        super().__init__()
        self.detector[1].train()


@breaks("victim_is_frozen")
class GradientVictim(Lawful):
    def __init__(self) -> None:
        super().__init__()
        self.detector[0].bias.grad = torch.zeros(2)


@breaks("ends_at_max_frames")
class OneTooMany(Lawful):
    def __init__(self) -> None:
        super().__init__()
        self.settings.max_frames = 5
        self.limit = 4

    def step(self, actions: Any) -> Any:
        observations, rewards, ends, _, infos = super().step(actions)
        over = self.frame >= self.limit
        self.agents = [] if over else self.possible_agents[:]
        return observations, rewards, ends, self.flags(over), infos


@breaks("ends_at_max_frames")
class Terminates(Lawful):
    def step(self, actions: Any) -> Any:
        observations, rewards, ends, over, infos = super().step(actions)
        return observations, rewards, over, ends, infos


@breaks("step_needs_reset")
class Undead(Lawful):
    def step(self, actions: Any) -> Any:
        if not self.agents:
            self.reset()
        return super().step(actions)


@breaks("slots_are_numbered")
class NamedAgents(Lawful):
    def __init__(self) -> None:
        super().__init__()
        names = {"adversary_0": "Alice", "adversary_1": "Bob"}
        self.possible_agents = list(names.values())
        self._seen = {names[agent]: space for agent, space in self._seen.items()}
        self._done = {names[agent]: space for agent, space in self._done.items()}

    def rewards(self) -> dict[str, float]:
        return dict.fromkeys(self.possible_agents, 1.0)


@breaks("slots_are_numbered")
class HalfBox(Lawful):
    def __init__(self) -> None:
        super().__init__()
        self._done = {agent: spaces.Box(0.0, 1.0, (2,), np.float32) for agent in self.possible_agents}

    def checked(self, actions: Any) -> np.ndarray:
        return np.clip(super().checked(actions), 0.0, 1.0)
