"""The table of context entries: names, sizes and values follow from it."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
import pytest

from cp_env.envs.context import COLUMNS, POOL, columns_of, context_names
from cp_env.envs.observation import state_names
from cp_env.envs.parallel import CollaborativePerceptionEnv
from cp_env.settings import KNOWLEDGE

Make = Callable[..., CollaborativePerceptionEnv]


def test_sizes_by_hand() -> None:
    """9 entries of the slot, 6 of the last frame, 4 N + 16 of the defence and the scene."""
    for n in (2, 5, 9):
        assert [len(context_names(level, n)) for level in KNOWLEDGE] == [9, 15, 15 + 4 * n + POOL**2]
    assert len(state_names(5)) == 5 * (7 + POOL**2) + 2 + 6 + 3 * 5 + POOL**2


def test_names_are_distinct_and_each_level_begins_with_the_one_before() -> None:
    names = [context_names(level, 5) for level in KNOWLEDGE]
    assert all(longer[: len(shorter)] == shorter for shorter, longer in itertools.pairwise(names))
    assert len(set(names[-1])) == len(names[-1]) and len(set(state_names(5))) == len(state_names(5))
    with pytest.raises(ValueError, match="unknown knowledge 'grey'"):
        context_names("grey")


def test_every_entry_says_what_it_is() -> None:
    for column in columns_of("white-box"):
        assert column.meaning and column.unit and column.scale, column.name
    assert set(COLUMNS) == set(KNOWLEDGE)


def test_entries_stand_where_their_names_say(toy_env: Make) -> None:
    """By hand from the infos: role flags, the last norm over Δ, and what the frame cost."""
    env = toy_env("robosac", knowledge="white-box", n_attackers=2, attackers=(0, 3))
    names = context_names("white-box", 5)
    env.reset(seed=1)
    for _ in range(2):
        observations, *_, infos = env.step({agent: np.ones(8, np.float32) for agent in env.agents})
        for agent, vehicle in zip(env.agents, (0, 3), strict=True):
            read = dict(zip(names, observations[agent]["context"].tolist(), strict=True))
            told = infos[agent]
            assert (read["malicious"], read["ego"], read["vehicle"]) == (1, vehicle == 0, pytest.approx(vehicle / 5))
            assert read["norm"] == pytest.approx(told["perturbation_norm"] / 0.3, abs=1e-6)
            assert read["damage"] == pytest.approx(told["damage"]) and read["excluded"] == told["excluded"]
            assert read["verifications"] == pytest.approx(min(told["verifications"] / 8, 1))
            assert read["n_collaborators"] == pytest.approx(told["collaborators"] / 5)
            assert [read[f"attacker_{i}"] for i in range(5)] == [1, 0, 0, 1, 0]
            assert [read[f"own_{i}"] for i in range(5)] == [float(i == vehicle) for i in range(5)]


def test_the_compact_state_is_the_slots_entries_and_the_worlds(toy_env: Make) -> None:
    env = toy_env("none", state="compact", attackers=(1, 2), knowledge="white-box")
    observations, _ = env.reset(seed=0)
    state = dict(zip(state_names(5), env.state().tolist(), strict=True))
    assert env.state_space.contains(env.state())
    own = dict(zip(context_names("white-box", 5), observations["adversary_0"]["context"].tolist(), strict=True))
    for name in ("malicious", "x", "y", "vehicle"):
        assert state[f"vehicle_1.{name}"] == pytest.approx(own[name])
    assert [state[f"vehicle_{i}.malicious"] for i in range(5)] == [0, 1, 1, 0, 0]
    assert [state[f"attacker_{i}"] for i in range(5)] == [0, 1, 1, 0, 0]
    assert state["scene_3"] == pytest.approx(own["scene_3"])


def test_the_state_of_maps_is_as_it_was(toy_env: Make) -> None:
    env = toy_env("none")
    env.reset(seed=0)
    assert env.state().shape == env.state_space.shape == (5, 8, 32, 32)
