"""A native Stable-Baselines3 `VecEnv`: every attacker of every world is one environment of SB3's, or every world is.

Shared: environment i drives slot i mod k of world i div k, so the attackers share a policy and the team's reward.
Joint: environment i is world i; one actor gets the observations of all its attackers and moves them all, end to end.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Unpack

import numpy as np
from gymnasium import Wrapper
from numpy.typing import NDArray

import agents.protocol  # noqa: F401 (it refuses to work beside a package of the same name)
from cp_env.envs.actions.base import real_numbers
from cp_env.envs.core import Game, Infos
from cp_env.envs.joint import join, joint_space
from cp_env.envs.parallel import options_text
from cp_env.envs.render_mixin import RENDER_FPS
from cp_env.settings import Options
from cp_env.world.scene_cache import SceneBank
from defenders.protocol import Defender
from defenders.registry import shown

try:
    from stable_baselines3.common.vec_env import VecEnv
    from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvObs, VecEnvStepReturn
except ImportError as error:
    raise ImportError(
        "this needs Stable-Baselines3, which is installed with an extra: pip install 'cp-env[agents]'"
    ) from error

RENDER_MODES = (None, "rgb_array")


def make_vec_env(
    num_envs: int,
    defender: str | Defender | Callable[[], Defender] = "prbi",
    *,
    joint: bool = False,
    bank: SceneBank | None = None,
    **options: Unpack[Options],
) -> AdversaryVecEnv:
    """Worlds of k attackers as a VecEnv of `num_envs * k` environments, or of `num_envs` joint ones.

    Args:
        num_envs: number of worlds.
        defender: name, object or factory.
        joint: one environment a world instead of one an attacker.
        bank: encoded scenes with their source and detector, instead of the options that name them.
        **options: as in `cp_env.parallel_env`, but `observation` is "compact" by default, a vector that a small network
            reads, and `render_mode` is None or "rgb_array".

    Returns:
        The environments.
    """
    options.setdefault("observation", "compact")
    render_mode = options.pop("render_mode", None)
    return AdversaryVecEnv(Game(num_envs, defender, bank=bank, **options), joint=joint, render_mode=render_mode)


class AdversaryVecEnv(VecEnv):
    """A `Game` seen by SB3. A world whose episode ends begins a new one in the same step, for all its slots.

    The infos of a last step carry `terminal_observation` and, since nothing ever terminates, `TimeLimit.truncated`.
    `seed()` and `set_options()` hold for the next `reset()` and are then forgotten; a world takes its first slot's.
    The infos of a joint environment are means over its attackers.
    """

    def __init__(self, game: Game, *, joint: bool = False, render_mode: str | None = None) -> None:
        if render_mode is not None and not (isinstance(render_mode, str) and render_mode in RENDER_MODES):
            raise ValueError(f"render_mode must be one of {RENDER_MODES}, got {shown(render_mode)}")
        self.game, self.joint, self.render_mode, self.n_slots = game, joint, render_mode, len(game.slots)
        self.n_seats = 1 if joint else self.n_slots  # environments of SB3's a world
        self._actions: NDArray[Any] | None = None
        per_seat = self.n_slots // self.n_seats
        super().__init__(
            game.num_envs * self.n_seats,
            joint_space(game.single_observation_space, per_seat),
            joint_space(game.single_action_space, per_seat),
        )
        self.render_mode = render_mode
        self.metadata = {**self.metadata, "render_fps": RENDER_FPS}  # type: ignore[dict-item]  # else SB3 films at 30

    def __repr__(self) -> str:
        of = f"{self.game.num_envs}, {options_text(self.game)}, joint={self.joint}"
        return f"{type(self).__name__}({of}, render_mode={self.render_mode!r})"

    def reset(self) -> VecEnvObs:
        """Begin new episodes in all worlds; the observations (n, …), or a dict of them."""
        first = slice(None, None, self.n_seats)
        seeds, options = self._seeds[first], self._options[first]
        observations, infos = self.game.reset(seeds, options=options)
        self._reset_seeds()
        self._reset_options()
        self.reset_infos = self._rows(infos)
        return self._flat(observations)

    def step_async(self, actions: Any) -> None:
        """Keep the actions (n, …) for `step_wait`."""
        numbers = real_numbers(actions, "the actions")
        if numbers.shape != (self.num_envs, *(self.action_space.shape or ())):
            raise ValueError(
                f"actions must have shape {(self.num_envs, *(self.action_space.shape or ()))}, not {numbers.shape}"
            )
        self._actions = numbers

    def step_wait(self) -> VecEnvStepReturn:
        """One frame of every world: observations, rewards (n,), dones (n,) and infos."""
        if self._actions is None:
            raise RuntimeError("step_wait() needs the actions of a step_async() before it")
        actions, self._actions = self._actions, None
        observations, reward, truncated, infos = self.game.step(
            actions.reshape(self.game.num_envs, self.n_slots, *self.game.single_action_space.shape)
        )
        dones, rows, flat = np.repeat(truncated, self.n_seats), self._rows(infos), self._flat(observations)
        over = np.flatnonzero(truncated).tolist()
        if over:
            for i in np.flatnonzero(dones):
                rows[i] |= {"terminal_observation": _row(flat, int(i)), "TimeLimit.truncated": True}
            observations, infos = self.game.reset([None] * len(over), worlds=over)
            fresh, flat = self._rows(infos), self._flat(observations)
            for i in np.flatnonzero(dones):
                self.reset_infos[i] = fresh[i]
        return flat, reward[:, : self.n_seats].reshape(-1).astype(np.float32), dones, rows

    def close(self) -> None:
        """Nothing is held open."""

    def get_images(self) -> Sequence[np.ndarray | None]:
        """One image a world: environments of one world look the same, and SB3 tiles what it gets."""
        return [self.game.render(e) for e in range(self.game.num_envs)]

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """The attribute of this object, or else of the game, once for each index."""
        owner = self if hasattr(self, attr_name) else self.game
        return [getattr(owner, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set an attribute of this object; the environments share it."""
        setattr(self, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: VecEnvIndices = None, **kwargs: Any) -> list[Any]:
        """Call a method of the game with each index's world as its last positional argument."""
        method = getattr(self.game, method_name)
        return [method(*args, i // self.n_seats, **kwargs) for i in self._get_indices(indices)]

    def env_is_wrapped(
        self, wrapper_class: type[Wrapper[Any, Any, Any, Any]], indices: VecEnvIndices = None
    ) -> list[bool]:
        """No gymnasium wrapper can stand between SB3 and the game."""
        return [False for _ in self._get_indices(indices)]

    def _rows(self, infos: Infos) -> list[dict[str, Any]]:
        columns = {key: self._by_seat(values).ravel().tolist() for key, values in infos.items()}
        return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]

    def _by_seat(self, values: NDArray[Any]) -> NDArray[Any]:
        return values.mean(axis=1) if self.joint else values

    def _flat(self, observations: VecEnvObs) -> VecEnvObs:
        assert not isinstance(observations, tuple)
        if self.joint:
            return join(observations)
        if isinstance(observations, dict):
            return {key: value.reshape(-1, *value.shape[2:]) for key, value in observations.items()}
        return observations.reshape(-1, *observations.shape[2:])


def _row(observations: VecEnvObs, i: int) -> NDArray[Any] | dict[str, NDArray[Any]]:
    if isinstance(observations, dict):
        return {key: value[i].copy() for key, value in observations.items()}
    assert isinstance(observations, np.ndarray)
    return np.array(observations[i])
