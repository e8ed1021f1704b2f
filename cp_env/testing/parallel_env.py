"""Rules for any PettingZoo `ParallelEnv` with a constant set of agents."""

from __future__ import annotations

import copy
import itertools
import math
import numbers
import pickle
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from gymnasium import Space, spaces

from cp_env.testing.rollout import Call, Case, Env, arrays, difference, require

Rule = Callable[[Case], None]


def spaces_are_fixed(case: Case) -> None:
    """`observation_space(agent)` and `action_space(agent)` return the same object each time."""
    env = case.make()
    require(bool(env.possible_agents), "possible_agents is empty")
    require(
        len(set(env.possible_agents)) == len(env.possible_agents), f"possible_agents repeats: {env.possible_agents}"
    )
    for agent, method in itertools.product(env.possible_agents, ("observation_space", "action_space")):
        space = getattr(env, method)(agent)
        require(isinstance(space, Space), f"{method}({agent!r}) is no gymnasium Space but a {type(space).__name__}")
        require(space is getattr(env, method)(agent), f"{method}({agent!r}) returns another object each time")


def agents_are_constant(case: Case) -> None:
    """All of `possible_agents` live from reset to the end of the episode, and then none does."""
    player = case.player()
    everyone = list(player.env.possible_agents)
    player.reset(case.seed)
    for _ in range(case.steps):
        call = player.last
        assert call is not None
        over = any([*call.terminations.values(), *call.truncations.values()])
        expected = [] if over else everyone
        require(player.env.agents == expected, f"agents is {player.env.agents} after {call.name}, not {expected}")
        require(player.env.possible_agents == everyone, f"possible_agents became {player.env.possible_agents}")
        player.advance()


def dicts_are_complete(case: Case) -> None:
    """Every dict returned by `reset` and `step` has exactly the agents as keys."""
    everyone = set(case.make().possible_agents)
    for call in case.calls:
        for name, returned in call.dicts.items():
            require(isinstance(returned, dict), f"{call.name} returned {name} as a {type(returned).__name__}")
            require(
                set(returned) == everyone, f"{call.name} returned {name} for {sorted(returned)}, not {sorted(everyone)}"
            )


def _observed(case: Case) -> Iterator[tuple[str, Space[Any], Any]]:
    """Every (where, leaf space, leaf of an observation) of the transcript."""
    env = case.make()
    for number, call in enumerate(case.calls):
        for agent, observation in call.observations.items():
            yield from _leaves(f"call {number} ({call.name}), {agent}", env.observation_space(agent), observation)


def _leaves(where: str, space: Space[Any], data: Any) -> Iterator[tuple[str, Space[Any], Any]]:
    if isinstance(space, spaces.Dict) and isinstance(data, dict) and data.keys() == space.keys():
        for key in space:
            yield from _leaves(f"{where}[{key!r}]", space[key], data[key])
    else:
        yield where, space, data


def observations_have_their_type(case: Case) -> None:
    """Arrays have exactly the shape and dtype their space declares (`contains` alone lets narrower dtypes pass)."""
    for where, space, data in _observed(case):
        require(
            not isinstance(space, spaces.Dict), f"{where}: the keys of a Dict observation are not those of its space"
        )
        if isinstance(space, spaces.Box | spaces.MultiBinary | spaces.MultiDiscrete):
            require(isinstance(data, np.ndarray), f"{where} is no array but a {type(data).__name__}")
            require(data.shape == space.shape, f"{where} has shape {data.shape}, its space {space.shape}")
            require(data.dtype == space.dtype, f"{where} has dtype {data.dtype}, its space {space.dtype}")


def observations_are_contained(case: Case) -> None:
    """Every observation, those of `reset` included, lies in its space."""
    for where, space, data in _observed(case):
        if isinstance(space, spaces.Box) and isinstance(data, np.ndarray) and data.shape == space.shape:
            outside = ~((data >= space.low) & (data <= space.high))
            require(
                not outside.any(),
                f"{where}: {outside.sum()} of {data.size} entries outside the Box, such as {data[outside][:3]}",
            )
        require(space.contains(data), f"{where} is not in {space}")


def observations_are_finite(case: Case) -> None:
    """No observation holds NaN or infinity, even where its Box is unbounded."""
    for where, _, data in _observed(case):
        for array in arrays(data):
            if array.dtype.kind in "fc":
                require(np.isfinite(array).all(), f"{where}: {np.sum(~np.isfinite(array))} entries are not finite")


def infos_are_numbers(case: Case) -> None:
    """Infos hold finite scalars under keys that never change (TorchRL makes tensors of them), each of constant kind."""
    kinds: dict[str, type] | None = None
    for number, call in enumerate(case.calls):
        for agent, info in call.infos.items():
            where = f"info of {agent} in call {number} ({call.name})"
            for key, value in info.items():
                require(isinstance(value, numbers.Real | np.bool_), f"{where}: {key!r} is no number but {value!r}")
                require(math.isfinite(value), f"{where}: {key!r} is {value!r}, not finite")
            here = {key: type(value) for key, value in info.items()}
            kinds = here if kinds is None else kinds
            require(
                here.keys() == kinds.keys(), f"{where} has other keys than before: {sorted(here.keys() ^ kinds.keys())}"
            )
            changed = [key for key in here if here[key] is not kinds[key]]
            require(not changed, f"{where}: the type of {changed} is not what it was")


def rewards_are_floats(case: Case) -> None:
    """Rewards are finite floats, not integers and not arrays."""
    for number, call in enumerate(case.calls):
        for agent, reward in call.rewards.items():
            require(
                isinstance(reward, float | np.floating) and math.isfinite(reward),
                f"call {number}: the reward of {agent} is {reward!r} ({type(reward).__name__}), not a finite float",
            )


def flags_are_bools(case: Case) -> None:
    """Terminations and truncations are Python's True and False."""
    for number, call in enumerate(case.calls):
        for name in ("terminations", "truncations"):
            for agent, flag in getattr(call, name).items():
                require(
                    isinstance(flag, bool), f"call {number}: {name}[{agent!r}] is {flag!r}, a {type(flag).__name__}"
                )


def _require_same(a: list[Call], b: list[Call], what: str) -> None:
    for number, (x, y) in enumerate(zip(a, b, strict=True)):
        found = difference(x, y)
        require(found is None, f"{what}: call {number} ({x.name}): {found}")


def same_seed_same_trajectory(case: Case) -> None:
    """Two instances with the same seed and actions return the same, bit for bit: all five dicts."""
    _require_same(case.calls, case.transcript(case.seed), "two instances of one seed")
    player = case.player()
    player.reset(case.seed + 1)
    player.play(min(2, case.steps))
    again = [player.reset(case.seed).snapshot()]
    first = difference(case.calls[0], again[0])
    require(first is None, f"reset(seed) of a used instance is not that of a fresh one: {first}")


def seeds_differ(case: Case) -> None:
    """Different seeds, different trajectories, under the same actions."""
    if difference(case.calls, case.other_calls) is None:
        others = (case.transcript(case.seed + offset) for offset in (2, 3))
        require(
            any(difference(case.calls, other) is not None for other in others),
            f"the seeds {case.seed} … {case.seed + 3} all give the same trajectory",
        )


def stream_goes_on(case: Case) -> None:
    """`reset()` without a seed goes on with the seeded stream: it gives other episodes, and reproducible ones."""

    def episodes() -> list[Call]:
        player = case.player()
        return [player.reset(case.seed).snapshot(), *(player.reset().snapshot() for _ in range(3))]

    first, *later = run = episodes()
    require(
        any(difference(first, call) is not None for call in later),
        "reset() without a seed begins the same episode again and again",
    )
    _require_same(run, episodes(), "resets without a seed after one with a seed")


def instances_are_independent(case: Case) -> None:
    """Two instances stepped in turn do what each does alone."""
    one, two = case.player(), case.player()
    calls: list[tuple[Call, Call]] = [(one.reset(case.seed).snapshot(), two.reset(case.seed + 1).snapshot())]
    calls += [(one.advance().snapshot(), two.advance().snapshot()) for _ in range(case.steps)]
    _require_same(case.calls, [call for call, _ in calls], "an instance disturbed by another")
    _require_same(case.other_calls, [call for _, call in calls], "an instance disturbed by another")


def pickling_changes_nothing(case: Case) -> None:
    """An instance pickled in the middle of an episode goes on as if it had not been, and so does the original."""
    player = case.player()
    player.reset(case.seed)
    before = max(1, case.steps // 3)
    player.play(before)
    twin = copy.copy(player)
    twin.spaces = copy.deepcopy(player.spaces)
    twin.env = pickle.loads(pickle.dumps(player.env))
    rest = case.steps - before
    _require_same(case.calls[1 + before :], twin.play(rest), "the unpickled instance")
    _require_same(case.calls[1 + before :], player.play(rest), "the instance that was pickled")


def nothing_is_shared(case: Case) -> None:
    """What is returned is the caller's: no memory shared between calls or agents, no dict returned twice."""
    player = case.player()
    calls = [player.reset(case.seed)] + [player.advance() for _ in range(min(3, case.steps))]
    held = [
        (f"{call.name} {number}, {agent}", array)
        for number, call in enumerate(calls)
        for agent, observation in call.observations.items()
        for array in arrays(observation)
    ]
    for (here, a), (there, b) in itertools.combinations(held, 2):
        require(not np.shares_memory(a, b), f"the observations of {here} and of {there} share memory")
    dicts = [(f"{name} of call {number}", one) for number, call in enumerate(calls) for name, one in call.dicts.items()]
    dicts += [
        (f"info of {agent} of call {n}", one) for n, call in enumerate(calls) for agent, one in call.infos.items()
    ]
    for (here, x), (there, y) in itertools.combinations(dicts, 2):
        require(x is not y, f"{here} and {there} are one and the same dict")


def scribbling_is_harmless(case: Case) -> None:
    """Overwriting what was returned, `state()` included, or the actions handed in does not change the environment."""
    player = case.player()
    call = player.reset(case.seed)
    for number, expected in enumerate(case.calls):
        found = difference(expected, call)
        require(found is None, f"after the caller wrote into what was returned, call {number} differs: {found}")
        _scribble(player.env, call)
        if number == case.steps:
            break
        if not player.env.agents:
            call = player.reset()
            continue
        player.last = expected  # what masks are read from
        actions = player.actions()
        given = copy.deepcopy(actions)
        call = player.step(actions)
        found = difference(given, actions)
        require(found is None, f"step() wrote into the actions it was given: {found}")
        for array in arrays(actions):
            array.fill(0)


def _scribble(env: Env, call: Call) -> None:
    state = _state(env)
    for array in arrays([call.observations, call.infos, state]):
        if array.flags.writeable:
            array.fill(1)
    for one in call.dicts.values():
        one.clear()


def _state(env: Env) -> Any:
    try:
        return env.state()
    except NotImplementedError:  # PettingZoo's way of having none
        return None


def state_is_constant(case: Case) -> None:
    """`state()`, where there is one, keeps its shape and dtype, lies in `state_space`, reads without side effects."""
    player = case.player()
    player.reset(case.seed)
    first = _state(player.env)
    if first is None:
        return
    space = getattr(player.env, "state_space", None)
    for number in range(case.steps):
        state = _state(player.env)
        require(isinstance(state, np.ndarray), f"state() is no array but a {type(state).__name__}")
        same = (state.shape, state.dtype) == (first.shape, first.dtype)
        require(same, f"state() was {first.dtype}{list(first.shape)} and is {state.dtype}{list(state.shape)}")
        require(np.isfinite(state).all(), f"state() holds numbers that are not finite after {number} calls")
        require(space is None or space.contains(state), f"state() is not in state_space after {number} calls")
        require(difference(state, _state(player.env)) is None, "state() differs when it is read twice")
        call = player.advance()
        found = difference(case.calls[number + 1], call)
        require(found is None, f"reading state() changed the trajectory: {found}")


def rendering_changes_nothing(case: Case) -> None:
    """With `render_mode` "rgb_array", `render()` gives a (h, w, 3) uint8 picture and leaves the trajectory alone."""
    player = case.player()
    if getattr(player.env, "render_mode", None) != "rgb_array":
        return
    call = player.reset(case.seed)
    for expected in case.calls:
        found = difference(expected, call)
        require(found is None, f"render() changed the trajectory: {found}")
        picture = player.env.render()
        good = isinstance(picture, np.ndarray) and picture.dtype == np.uint8 and picture.shape[2:] == (3,)
        require(good, f"render() must return uint8 (h, w, 3), got {getattr(picture, 'shape', type(picture).__name__)}")
        call = player.advance()


PARALLEL_ENV_RULES: tuple[Rule, ...] = (
    spaces_are_fixed,
    agents_are_constant,
    dicts_are_complete,
    observations_have_their_type,
    observations_are_contained,
    observations_are_finite,
    infos_are_numbers,
    rewards_are_floats,
    flags_are_bools,
    same_seed_same_trajectory,
    seeds_differ,
    stream_goes_on,
    instances_are_independent,
    pickling_changes_nothing,
    nothing_is_shared,
    state_is_constant,
    scribbling_is_harmless,
    rendering_changes_nothing,
)
