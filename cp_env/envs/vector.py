"""The batched single-agent view (gymnasium `VectorEnv`): one joint adversary per world, all worlds in one forward."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Unpack

import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from jaxtyping import Bool
from numpy.typing import NDArray

from cp_env.envs.actions.base import real_numbers
from cp_env.envs.core import Game
from cp_env.envs.joint import Observation, join, joint_options, joint_space, split, world
from cp_env.envs.parallel import options_text
from cp_env.envs.render_mixin import RENDER_FPS, RENDER_MODES, check_render_mode
from cp_env.rendering.window import Window
from cp_env.settings import Options
from cp_env.world.scene_cache import SceneBank
from defenders.protocol import Defender
from defenders.registry import shown

Infos = dict[str, Any]
MODES = (AutoresetMode.SAME_STEP, AutoresetMode.DISABLED)


class JointAdversaryVectorEnv(VectorEnv[Any, NDArray[Any], NDArray[Any]]):
    """`num_envs` worlds; in each, one adversary drives all attackers. Its reward is the mean of theirs.

    The attackers' actions and observations are concatenated along their first axis: k actions (A,) make one (k·A,).
    Options as in `cp_env.parallel_env`, without `slots`. `observation` is "compact" unless said otherwise, which is
    what RL libraries learn on.

    Args:
        num_envs: E, worlds stepped together.
        autoreset_mode: "SameStep": a world whose episode ends is reset within that step; the observation that ended it
            stands in `info["final_obs"]`, its infos in `info["final_info"]`. "Disabled": reset it yourself, with
            `reset(options={"reset_mask": mask})`, before the next step. (A lock-step batch gains nothing from
            gymnasium's "NextStep".)
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 (gymnasium declares it so)
        "render_modes": list(RENDER_MODES),
        "render_fps": RENDER_FPS,
        "autoreset_mode": AutoresetMode.SAME_STEP,
    }

    def __init__(
        self,
        num_envs: int,
        defender: str | Defender | Callable[[], Defender] = "prbi",
        *,
        bank: SceneBank | None = None,
        autoreset_mode: str | AutoresetMode = AutoresetMode.SAME_STEP,
        **options: Unpack[Options],
    ) -> None:
        self._window = Window("collaborative perception", RENDER_FPS)  # first: gymnasium closes what failed to begin
        self.render_mode = check_render_mode(options.pop("render_mode", None))
        self.autoreset_mode = _supported(autoreset_mode)
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode}
        self.game = Game(num_envs, defender, bank=bank, **joint_options(options))
        self.num_envs = num_envs
        self.n_slots = len(self.game.slots)
        self.single_observation_space = joint_space(self.game.single_observation_space, self.n_slots)
        self.single_action_space = joint_space(self.game.single_action_space, self.n_slots)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._over = np.ones(num_envs, dtype=bool)  # worlds that wait for a reset
        self._begun = False

    def __repr__(self) -> str:
        options = options_text(self.game)
        return f"{type(self).__name__}({self.num_envs}, {options}, render_mode={self.render_mode!r})"

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, Infos]:
        """Begin an episode in every world, or in those of `options["reset_mask"]` (bool, (num_envs,)).

        An integer seeds world e with seed + e; a sequence gives each its own; None lets every world's stream go on.
        """
        seeds = self._seeds(seed)
        if options is not None and not isinstance(options, Mapping):
            raise ValueError(f"the options of a reset are a dict, not {type(options).__name__} {shown(options)}")
        options = {} if options is None else dict(options)
        mask = self._mask(options.pop("reset_mask", None))
        observations, infos = self._begin(mask, [s for s, m in zip(seeds, mask, strict=True) if m], options)
        self._follow()
        return join(observations), _batched(infos, mask)

    def step(self, actions: Any) -> tuple[Observation, NDArray[Any], NDArray[Any], NDArray[Any], Infos]:
        """One frame of every world. Rewards are float64 (E,); nothing ever terminates, the time limit truncates.

        ValueError for a wrong shape or numbers that are not finite; outside [-1, 1] they are clipped. A world whose
        defender fails is truncated, with a RuntimeWarning that names it and `info["failed"]` set.
        """
        if self._over.any():
            raise ResetNeeded(f"worlds {np.flatnonzero(self._over).tolist()} wait for reset() before step()")
        numbers = real_numbers(actions, "the actions")
        if numbers.shape != self.action_space.shape:
            raise ValueError(f"actions must have shape {self.action_space.shape}, got {numbers.shape}")
        observations, reward, truncated, infos = self.game.step(split(numbers, self.n_slots))
        self._report_failures()
        self._over = truncated.copy()
        final: Infos = {}
        if truncated.any() and self.autoreset_mode is AutoresetMode.SAME_STEP:
            final = self._final(observations, infos, truncated)
            observations, infos = self._begin(truncated, [None] * int(truncated.sum()), {})
        self._follow()
        everyone = np.ones(self.num_envs, dtype=bool)
        rewards = reward.mean(axis=1, dtype=np.float64)
        return join(observations), rewards, ~everyone, truncated.copy(), {**_batched(infos, everyone), **final}

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """One picture (h, w, 3) a world for "rgb_array"; for "human" the window is brought up to date."""
        if self.render_mode == "rgb_array":
            return tuple(self.game.render(e) for e in range(self.num_envs))
        self._follow()
        return None

    def close_extras(self, **kwargs: Any) -> None:
        """Close the window."""
        self._window.close()

    def _begin(
        self, mask: Bool[np.ndarray, " E"], seeds: list[int | None], options: dict[str, Any]
    ) -> tuple[Observation, dict[str, NDArray[Any]]]:
        started = self.game.reset(seeds, worlds=np.flatnonzero(mask).tolist(), options=options)
        self._begun = True
        self._over = self._over & ~mask
        return started

    def _final(self, observations: Observation, infos: dict[str, NDArray[Any]], over: Bool[np.ndarray, " E"]) -> Infos:
        last = np.full(self.num_envs, None, dtype=object)
        joined = join(observations)
        for e in np.flatnonzero(over).tolist():
            last[e] = world(joined, e)
        return {
            "final_obs": last,
            "_final_obs": over.copy(),
            "final_info": _batched(infos, over),
            "_final_info": over.copy(),
        }

    def _report_failures(self) -> None:
        for e, error in enumerate(self.game.errors):
            if error is not None:
                warnings.warn(
                    f"world {e}: its episode ends here, the others go on: {error}", RuntimeWarning, stacklevel=3
                )

    def _follow(self) -> None:
        if self.render_mode == "human":
            self._window.show(np.concatenate([self.game.render(e) for e in range(self.num_envs)], axis=1))

    def _seeds(self, seed: int | Sequence[int | None] | None) -> list[int | None]:
        if seed is None:
            return [None] * self.num_envs
        if isinstance(seed, Sequence) and not isinstance(seed, str | bytes):
            if len(seed) != self.num_envs:
                raise ValueError(f"give one seed a world, {self.num_envs}, or one integer for all; got {len(seed)}")
            return list(seed)
        if isinstance(seed, bool) or not isinstance(seed, int | np.integer):
            raise ValueError(f"give one seed a world, {self.num_envs}, or one integer for all; got {shown(seed)}")
        return [int(seed) + e for e in range(self.num_envs)]

    def _mask(self, mask: Any) -> Bool[np.ndarray, " E"]:
        if mask is None:
            return np.ones(self.num_envs, dtype=bool)
        try:
            array = np.asarray(mask)
        except Exception:  # whatever an object of others raises, it is no mask
            array = np.zeros(0)
        if array.shape != (self.num_envs,) or array.dtype != bool or not array.any():
            raise ValueError(
                f"reset_mask must be {self.num_envs} booleans, at least one of them True; got {shown(mask)}"
            )
        mask = array
        if not self._begun and not mask.all():
            raise ResetNeeded("reset every world once before you reset some of them")
        return mask


def _batched(infos: dict[str, NDArray[Any]], mask: Bool[np.ndarray, " E"]) -> Infos:
    """Infos as gymnasium batches them: for each key, `_key` says which worlds it is about."""
    batched: Infos = {}
    for key, values in infos.items():
        batched[key], batched[f"_{key}"] = values.copy(), mask.copy()
    return batched


def _supported(mode: str | AutoresetMode) -> AutoresetMode:
    known = {supported.value: supported for supported in MODES}
    value = mode.value if isinstance(mode, AutoresetMode) else mode
    if not isinstance(value, str) or value not in known:
        raise ValueError(f"autoreset_mode must be one of {list(known)}, got {shown(value)}")
    return known[value]
