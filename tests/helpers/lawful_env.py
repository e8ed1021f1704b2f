"""A small environment that keeps every rule of `cp_env.testing`, and needs no detector worth the name.

Two agents push a hidden target about; what they push is clipped to a ball. Mutants of it break one rule each.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import torch
from gymnasium import spaces
from pettingzoo import ParallelEnv


class Lawful(ParallelEnv[str, dict[str, np.ndarray], np.ndarray]):
    metadata: ClassVar[dict[str, Any]] = {"name": "lawful_v0", "render_modes": ["rgb_array"], "render_fps": 5}

    def __init__(self, *, max_frames: int = 4, budget: float = 0.3, render_mode: str | None = "rgb_array") -> None:
        self.render_mode = render_mode
        self.detector = torch.nn.Sequential(torch.nn.Linear(2, 2), torch.nn.BatchNorm1d(2)).eval().requires_grad_(False)
        self.settings = SimpleNamespace(max_frames=max_frames, budget=budget)
        self.possible_agents = ["adversary_0", "adversary_1"]
        self.agents: list[str] = []
        seen = spaces.Dict(place=spaces.Box(-9.0, 9.0, (3,), np.float32), clock=spaces.Box(0.0, 1.0, (1,), np.float32))
        self._seen = {agent: copy.deepcopy(seen) for agent in self.possible_agents}
        self._done = {agent: spaces.Box(-1.0, 1.0, (2,), np.float32) for agent in self.possible_agents}
        self.state_space = spaces.Box(-9.0, 9.0, (3,), np.float32)
        self.rng = np.random.default_rng()

    @property
    def game(self) -> SimpleNamespace:
        return SimpleNamespace(settings=self.settings, world=SimpleNamespace(detector=self.detector))

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        return self._seen[self.known(agent)]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        return self._done[self.known(agent)]

    def known(self, agent: str) -> str:
        if agent not in self.possible_agents:
            raise ValueError(f"no agent {agent!r}; the agents are {self.possible_agents}")
        return agent

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[dict, dict]:
        if seed is not None:
            self.rng = np.random.default_rng(seed)
        self.target = self.rng.uniform(-1, 1, 3).astype(np.float32)
        self.frame = 0
        self.norms = [0.0, 0.0]
        self.agents = self.possible_agents[:]
        return self.observations(), self.infos()

    def step(self, actions: dict[str, np.ndarray]) -> tuple[dict, dict, dict, dict, dict]:
        if not self.agents:
            raise RuntimeError("call reset() first")
        pushes = self.settings.budget * np.clip(self.checked(actions), -1.0, 1.0)
        self.norms = np.abs(pushes).max(axis=1).tolist()
        drift = self.rng.normal(0, 0.01, 3)
        self.target = np.clip(self.target + np.append(pushes.sum(axis=0), 0.0) + drift, -9, 9).astype(np.float32)
        self.frame += 1
        over = self.frame >= self.settings.max_frames
        if over:
            self.agents = []
        return self.observations(), self.rewards(), self.flags(False), self.flags(over), self.infos()

    def checked(self, actions: dict[str, np.ndarray]) -> np.ndarray:
        if set(actions) != set(self.possible_agents):
            raise ValueError(f"actions for {self.possible_agents}, please")
        rows = [np.asarray(actions[agent]) for agent in self.possible_agents]
        if any(row.shape != (2,) or not np.isfinite(row).all() for row in rows):
            raise ValueError("two finite numbers each, please")
        return np.stack(rows)

    def observations(self) -> dict[str, dict[str, np.ndarray]]:
        return {agent: self.observe() for agent in self.possible_agents}

    def observe(self) -> dict[str, np.ndarray]:
        clock = np.array([self.frame / self.settings.max_frames], dtype=np.float32)
        return {"place": self.target.copy(), "clock": clock}

    def rewards(self) -> dict[str, float]:
        return dict.fromkeys(self.possible_agents, float(np.abs(self.target).sum()))

    def flags(self, value: bool) -> dict[str, bool]:
        return dict.fromkeys(self.possible_agents, value)

    def infos(self) -> dict[str, dict[str, Any]]:
        pairs = zip(self.possible_agents, self.norms, strict=True)
        return {agent: {"perturbation_norm": norm, "frame": self.frame} for agent, norm in pairs}

    def state(self) -> np.ndarray:
        return self.target.copy()

    def render(self) -> np.ndarray:
        return np.full((4, 6, 3), self.frame, dtype=np.uint8)

    def close(self) -> None: ...


MUTANTS: list[tuple[str, type[Lawful]]] = []
"""(rule, environment that breaks it), filled by importing the modules of mutants."""


def breaks(rule: str) -> Callable[[type[Lawful]], type[Lawful]]:
    """Enter a mutant under the rule it breaks first."""

    def enter(mutant: type[Lawful]) -> type[Lawful]:
        MUTANTS.append((rule, mutant))
        return mutant

    return enter
