"""Rules of our own environments: the ball, the frozen victim, what bad input gets, when an episode ends.

They read internals: `env.unwrapped.game` must have `settings` (budget, max_frames) and `world.detector`.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator
from typing import Any

import numpy as np
from gymnasium.spaces import Box

from cp_env.testing.parallel_env import Rule
from cp_env.testing.rollout import Case, Env, Player, difference, require


def is_ours(env: Env) -> bool:
    """Whether these rules apply."""
    return hasattr(getattr(env, "unwrapped", env), "game")


def _actions(player: Player, value: float) -> dict[str, np.ndarray]:
    """The same number everywhere, for every agent."""
    spaces = player.spaces.items()
    return {agent: np.full(space.shape, value, dtype=space.dtype) for agent, space in spaces}  # type: ignore[arg-type]


def _extremes(player: Player) -> Iterator[dict[str, np.ndarray]]:
    """The middle and the corners of the box, random corners, far outside, anything."""
    rng = np.random.default_rng(0)
    for value in (1.0, 0.0, -1.0, 1e6):
        yield _actions(player, value)
    while True:
        yield {
            agent: rng.choice([-1.0, 1.0], size=a.shape).astype(a.dtype) for agent, a in _actions(player, 0.0).items()
        }
        yield player.actions()


def ball_holds(case: Case) -> None:
    """No action makes a perturbation larger than the budget; some action makes one, unless all are excluded."""
    player = case.player()
    settings = player.env.unwrapped.game.settings
    budget = settings.budget
    player.reset(case.seed)
    largest, reaches, actions = 0.0, False, _extremes(player)
    for number in range(case.steps + 3 * settings.max_frames):
        if number >= case.steps and largest > 0:
            break
        if not player.env.agents:
            player.reset()
        for agent, info in player.step(next(actions)).infos.items():
            norm = info["perturbation_norm"]
            require(
                0 <= norm <= budget * (1 + 1e-5), f"{agent} sent a perturbation of norm {norm}, its budget is {budget}"
            )
            largest, reaches = max(largest, norm), reaches or not info.get("excluded", 0)
    require(
        largest > 0 or budget == 0 or not reaches,
        "no action, however extreme, perturbed anything: the budget was never put to use",
    )


def out_of_range_is_clipped(case: Case) -> None:
    """An action outside the box does what the nearest one inside does."""
    tame, wild = case.player(), case.player()
    found = difference(tame.reset(case.seed), wild.reset(case.seed))
    rng = np.random.default_rng(case.seed)
    for _ in range(min(case.steps, 3)):
        if found is not None or not tame.env.agents:
            break
        far = {agent: (3 * rng.standard_normal(a.shape)).astype(a.dtype) for agent, a in _actions(tame, 0.0).items()}
        near = {agent: np.clip(a, tame.spaces[agent].low, tame.spaces[agent].high) for agent, a in far.items()}  # type: ignore[attr-defined]
        found = difference(tame.step(near), wild.step(far))
    require(found is None, f"clipped and unclipped actions differ: {found}")


def _bad_actions(player: Player) -> Iterator[tuple[str, dict[str, Any]]]:
    good = _actions(player, 0.5)
    last, action = list(good.items())[-1]
    poisoned = {name: action.copy() for name in ("NaN", "infinity")}
    poisoned["NaN"].flat[-1], poisoned["infinity"].flat[0] = np.nan, np.inf
    for name, array in poisoned.items():
        yield f"{name} in an action", {**good, last: array}
    yield "an action with an axis too many", {**good, last: action[None]}
    yield "an action a number short", {**good, last: action[:-1]}
    yield "an action that is a number", {**good, last: 0.0}
    yield "no action for one agent", {agent: good[agent] for agent in good if agent != last}
    yield "an action for an unknown agent", {**good, "nobody_0": action}


def bad_actions_are_refused(case: Case) -> None:
    """NaN, infinity, wrong shapes, missing and unknown agents raise ValueError, and leave the world where it was."""
    player, undisturbed = case.player(), case.player()
    found = difference(undisturbed.reset(case.seed), player.reset(case.seed))
    for name, actions in _bad_actions(player):
        message = _refusal(lambda actions=actions: player.env.step(actions), ValueError)
        require(message is None, f"{name} must raise ValueError, but {message}")
    for _ in range(min(case.steps, 2)):
        if found is None and player.env.agents:
            found = difference(undisturbed.step(), player.step())
    require(found is None, f"a refused action changed the world: {found}")


def unknown_agents_are_refused(case: Case) -> None:
    """`observation_space` and `action_space` raise ValueError for a name they do not know, and list those they know."""
    env = case.make()
    for method in ("observation_space", "action_space"):
        try:
            getattr(env, method)("nobody_0")
        except ValueError as error:
            require(env.possible_agents[0] in str(error), f"{method}: the message does not list the agents: {error}")
        except Exception as error:
            require(False, f"{method}('nobody_0') must raise ValueError, but raised {error!r}")
        else:
            require(False, f"{method}('nobody_0') must raise ValueError, but returned a space")


def _refusal(call: Any, expected: type[Exception]) -> str | None:
    """None if the call raised what was expected; else what happened instead."""
    try:
        call()
    except expected:
        return None
    except Exception as error:
        return f"raised {error!r}"
    return "nothing was raised"


def _fingerprint(detector: Any) -> str:
    """A hash over every parameter and buffer of a torch module."""
    digest = hashlib.sha256()
    for tensors in (detector.named_parameters(), detector.named_buffers()):
        for name, tensor in tensors:
            digest.update(name.encode() + tensor.detach().cpu().numpy().tobytes())
    return digest.hexdigest()


def victim_is_frozen(case: Case) -> None:
    """Whatever agents do, the detector's weights and buffers stay, in evaluation mode, without gradients."""
    player = case.player()
    detector = player.env.unwrapped.game.world.detector
    before = _fingerprint(detector)
    player.reset(case.seed)
    actions = _extremes(player)
    for _ in range(case.steps):
        if not player.env.agents:
            player.reset()
        player.step(next(actions))
    require(_fingerprint(detector) == before, "the detector's weights or buffers changed while it was attacked")
    require(not any(module.training for module in detector.modules()), "the detector is in training mode")
    for name, parameter in detector.named_parameters():
        require(not parameter.requires_grad, f"the detector's parameter {name} requires a gradient")
        require(parameter.grad is None, f"the detector's parameter {name} has gathered a gradient")


def ends_at_max_frames(case: Case) -> None:
    """An episode is truncated, never terminated, and that in frame `max_frames` exactly, for all agents at once."""
    player = case.player()
    limit = player.env.unwrapped.game.settings.max_frames
    player.reset(case.seed)
    for frame in range(1, limit + 1):
        call = player.step(_actions(player, 0.0))
        require(not any(call.terminations.values()), f"an agent was terminated in frame {frame}")
        over = set(call.truncations.values())
        require(over == {frame == limit}, f"frame {frame} of {limit}: truncations are {call.truncations}")
    require(player.env.agents == [], f"agents is {player.env.agents} after the end")


def step_needs_reset(case: Case) -> None:
    """`step` before the first `reset` and after the end raises, and `reset` begins anew."""
    player = case.player()
    limit = player.env.unwrapped.game.settings.max_frames
    fresh = not player.env.agents  # an instance may have been handed over in the middle of an episode
    refused = _refusal(lambda: player.env.step(_actions(player, 0.0)), Exception) is None
    require(refused or not fresh, "step() before reset() must raise")
    player.reset(case.seed)
    for _ in range(limit):
        player.step()
    require(
        _refusal(lambda: player.env.step(_actions(player, 0.0)), Exception) is None, "step() after the end must raise"
    )
    player.reset()
    player.step()


def slots_are_numbered(case: Case) -> None:
    """Agents are called `name_0`, `name_1`, … (TorchRL groups them by name); actions are Boxes in [-1, 1]."""
    env = case.make()
    stem = re.sub(r"_\d+$", "", env.possible_agents[0])
    expected = [f"{stem}_{number}" for number in range(len(env.possible_agents))]
    require(list(env.possible_agents) == expected, f"possible_agents is {env.possible_agents}, not {expected}")
    for agent in env.possible_agents:
        space = env.action_space(agent)
        unit = isinstance(space, Box) and (space.low == -1).all() and (space.high == 1).all()
        require(unit, f"action_space({agent!r}) is {space}, no Box in [-1, 1]")


CP_ENV_RULES: tuple[Rule, ...] = (
    ball_holds,
    out_of_range_is_clipped,
    bad_actions_are_refused,
    unknown_agents_are_refused,
    victim_is_frozen,
    ends_at_max_frames,
    step_needs_reset,
    slots_are_numbered,
)
