"""The multi-agent environment (PettingZoo `ParallelEnv`): one world of the batched `Game`, one agent per slot."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Unpack

import numpy as np
from gymnasium import Space
from gymnasium.error import ResetNeeded
from jaxtyping import Float
from numpy.typing import NDArray
from pettingzoo import ParallelEnv

import defenders
from cp_env.envs.actions.base import real_numbers
from cp_env.envs.core import Game
from cp_env.envs.joint import Observation, world
from cp_env.envs.render_mixin import RENDER_FPS, RENDER_MODES, RenderMixin
from cp_env.settings import Options
from cp_env.world.scene_cache import SceneBank
from cp_env.world.verification import DefenderError
from defenders.protocol import Defender
from defenders.registry import shown

Infos = dict[str, dict[str, int | float]]


def raise_failure(game: Game) -> None:
    """DefenderError if the defender of a game of one world failed in the last step."""
    (error,) = game.errors
    if error is not None:
        raise DefenderError(error)


def options_text(game: Game) -> str:
    """The options of a game as they are written in a call: defender, scenes, and every setting; for `repr`."""
    defender = defenders.DEFENDERS.name_of(game.world.defenders[0])
    settings = {name: value for name, value in vars(game.settings).items() if value is not None}
    if "attackers" in settings:
        del settings["n_attackers"]  # these are counted
    options = {"defender": defender, "scenes": game.world.bank.source.name, **settings}
    return ", ".join(f"{name}={shown(value)}" for name, value in options.items())


class CollaborativePerceptionEnv(RenderMixin, ParallelEnv[str, Observation, NDArray[Any]]):
    """Agents are slots: `agents` is `possible_agents` from reset to the last frame, and empty when the episode is over.

    `cp_env.parallel_env` documents the options. `reset(options=...)` hands its options to `Game.reset`.
    """

    metadata: ClassVar[dict[str, Any]] = {
        "name": "collaborative_perception_v0",
        "render_modes": list(RENDER_MODES),
        "render_fps": RENDER_FPS,
        "is_parallelizable": True,
    }

    def __init__(
        self,
        defender: str | Defender | Callable[[], Defender] = "prbi",
        *,
        bank: SceneBank | None = None,
        **options: Unpack[Options],
    ) -> None:
        render_mode = options.pop("render_mode", None)
        self.show(Game(1, defender, bank=bank, **options), render_mode)
        self.possible_agents: list[str] = list(self.game.slots)
        self.agents: list[str] = []
        self.state_space = self.game.state_space
        names = self.possible_agents
        self._observation_spaces = {name: copy.deepcopy(self.game.single_observation_space) for name in names}
        self._action_spaces = {name: copy.deepcopy(self.game.single_action_space) for name in names}

    def __repr__(self) -> str:
        return f"{type(self).__name__}({options_text(self.game)}, render_mode={self.render_mode!r})"

    def observation_space(self, agent: str) -> Space[Any]:
        """The observation space of an agent: always the same object. ValueError for an unknown name."""
        return self._observation_spaces[self._known(agent)]

    def action_space(self, agent: str) -> Space[Any]:
        """The action space of an agent, a Box in [-1, 1]: always the same object. ValueError for an unknown name."""
        return self._action_spaces[self._known(agent)]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Observation], Infos]:
        """Begin an episode. With a seed the stream of episodes begins anew; without one it goes on."""
        observations, infos = self.game.reset([seed], options=options)
        self.agents = self.possible_agents[:]
        self._follow()
        return self._by_agent(observations), self._numbers(infos)

    def step(
        self, actions: Any
    ) -> tuple[dict[str, Observation], dict[str, float], dict[str, bool], dict[str, bool], Infos]:
        """One frame: every agent perturbs, the defender inspects, the ego drives on. The time limit is a truncation.

        ValueError if an action is missing, too many, of the wrong shape or not finite; outside [-1, 1] it is clipped.
        DefenderError if the defender fails: the episode is over, the environment may be reset.
        """
        if not self.agents:
            raise ResetNeeded("the episode is over (or never began): call reset() before step()")
        observations, reward, truncated, infos = self.game.step(self._stack(actions)[None])
        names, over = self.possible_agents, bool(truncated[0])
        if over:
            self.agents = []
        raise_failure(self.game)
        self._follow()
        return (
            self._by_agent(observations),
            {name: float(reward[0, slot]) for slot, name in enumerate(names)},
            dict.fromkeys(names, False),
            dict.fromkeys(names, over),
            self._numbers(infos),
        )

    def state(self) -> Float[np.ndarray, "..."]:
        """The central state, for critics: every vehicle's encoded map, or one vector (`state="compact"`)."""
        return self.game.state(0).copy()

    def _known(self, agent: str) -> str:
        if not isinstance(agent, str) or agent not in self._action_spaces:
            raise ValueError(f"no agent {shown(agent)}; the agents are {self.possible_agents}")
        return agent

    def _stack(self, actions: Any) -> NDArray[Any]:
        if not isinstance(actions, Mapping):
            raise ValueError(f"step() takes a dict from agent to action, not {type(actions).__name__}")
        for name in actions:
            self._known(name)
        missing = [name for name in self.possible_agents if name not in actions]
        if missing:
            raise ValueError(f"step() needs an action of every agent; none was given for {missing}")
        rows = [real_numbers(actions[name], f"the action of {name!r}") for name in self.possible_agents]
        shape = self.game.single_action_space.shape
        for name, row in zip(self.possible_agents, rows, strict=True):
            if row.shape != shape:
                raise ValueError(f"the action of {name!r} must have shape {shape}, got {row.shape}")
        return np.stack(rows)

    def _by_agent(self, observations: Observation) -> dict[str, Observation]:
        slots = world(observations, 0)
        return {name: world(slots, slot) for slot, name in enumerate(self.possible_agents)}

    def _numbers(self, infos: dict[str, NDArray[Any]]) -> Infos:
        return {
            name: {key: values[0, slot].item() for key, values in infos.items()}
            for slot, name in enumerate(self.possible_agents)
        }
