"""The single-agent view (gymnasium `Env`): one joint adversary drives all attackers of one world."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Unpack

import numpy as np
from gymnasium import Env
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray

from cp_env.envs.actions.base import real_numbers
from cp_env.envs.core import Game
from cp_env.envs.joint import Observation, join, joint_options, joint_space, split, world
from cp_env.envs.parallel import options_text, raise_failure
from cp_env.envs.render_mixin import RENDER_FPS, RENDER_MODES, RenderMixin
from cp_env.settings import Options
from cp_env.world.scene_cache import SceneBank
from defenders.protocol import Defender


class JointAdversaryEnv(RenderMixin, Env[Any, NDArray[Any]]):
    """One world with one adversary, which drives all attackers. Its reward is the mean of theirs.

    The attackers' actions and observations are concatenated along their first axis: k actions (A,) make one (k·A,).
    Options as in `cp_env.parallel_env`, without `slots`; `observation` is "compact" by default, what RL libraries learn
    on. An info holds one array of k numbers for every key.
    """

    metadata: dict[str, Any] = {"render_modes": list(RENDER_MODES), "render_fps": RENDER_FPS}  # noqa: RUF012

    def __init__(
        self,
        defender: str | Defender | Callable[[], Defender] = "prbi",
        *,
        bank: SceneBank | None = None,
        **options: Unpack[Options],
    ) -> None:
        render_mode = options.pop("render_mode", None)
        self.show(Game(1, defender, bank=bank, **joint_options(options)), render_mode)
        self.n_slots = len(self.game.slots)
        self.observation_space = joint_space(self.game.single_observation_space, self.n_slots)
        self.action_space = joint_space(self.game.single_action_space, self.n_slots)
        self._running = False

    def __repr__(self) -> str:
        return f"{type(self).__name__}({options_text(self.game)}, render_mode={self.render_mode!r})"

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode. With a seed the stream of episodes begins anew; without one it goes on."""
        observations, infos = self.game.reset([seed], options=options)  # first: it refuses what is no seed
        super().reset(seed=None if seed is None else int(seed))  # gymnasium's own generator, of which nothing is drawn
        self._running = True
        self._follow()
        return world(join(observations), 0), {key: values[0].copy() for key, values in infos.items()}

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """One frame. Nothing ever terminates; the time limit truncates.

        ValueError for a wrong shape or numbers that are not finite; outside [-1, 1] they are clipped.
        DefenderError if the defender fails: the episode is over, the environment may be reset.
        """
        if not self._running:
            raise ResetNeeded("the episode is over (or never began): call reset() before step()")
        numbers = real_numbers(action, "the action")
        if numbers.shape != self.action_space.shape:
            raise ValueError(f"the action must have shape {self.action_space.shape}, got {numbers.shape}")
        batch = numbers[None]
        observations, reward, truncated, infos = self.game.step(split(batch, self.n_slots))
        over = bool(truncated[0])
        self._running = not over
        raise_failure(self.game)
        self._follow()
        info = {key: values[0].copy() for key, values in infos.items()}
        return world(join(observations), 0), float(reward[0].mean(dtype=np.float64)), False, over, info
