"""Context columns of an observation: what each level of knowledge adds, and the numbers in them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from cp_env.envs.parallel import CollaborativePerceptionEnv
from cp_env.settings import KNOWLEDGE

Make = Callable[..., CollaborativePerceptionEnv]
ROLE, FEEDBACK, N = 9, 6, 5
FRAMES = 4


def contexts(toy_env: Make, knowledge: str, steps: int = 0, **options: Any) -> np.ndarray:
    """Contexts of both attackers, vehicles 1 and 3, one row each."""
    env = toy_env("none", attackers=(1, 3), knowledge=knowledge, grace_frames=1, max_frames=FRAMES, **options)
    observations, _ = env.reset(seed=3)
    for _ in range(steps):
        actions = {agent: np.ones_like(env.action_space(agent).sample()) for agent in env.agents}
        observations, *_ = env.step(actions)
    return np.stack([observations[agent]["context"] for agent in env.agents])


def test_each_level_adds_columns_behind_those_of_the_level_below(toy_env: Make) -> None:
    black, gray, white = (contexts(toy_env, knowledge, steps=2) for knowledge in KNOWLEDGE)
    assert [c.shape for c in (black, gray, white)] == [
        (2, ROLE),
        (2, ROLE + FEEDBACK),
        (2, ROLE + FEEDBACK + 4 * N + 16),
    ]
    assert np.array_equal(black, gray[:, :ROLE]) and np.array_equal(gray, white[:, : ROLE + FEEDBACK])


def test_the_role_by_hand(toy_env: Make) -> None:
    """Malicious, not the ego, not excluded, vehicle 1 of 5 (and 3); the clock; inert in the frame of grace."""
    first, later = contexts(toy_env, "black-box"), contexts(toy_env, "black-box", steps=2)
    assert first[:, :4] == pytest.approx(np.array([[1, 0, 0, 1 / N], [1, 0, 0, 3 / N]]))
    assert (first[:, 6] == 0).all() and later[:, 6] == pytest.approx([2 / FRAMES] * 2)
    assert not first[:, 7].any() and later[:, 7].all()
    assert not first[:, 8].any(), "nothing was sent yet"
    assert later[:, 8] == pytest.approx([1, 1], rel=1e-4), "an action of full strength sends the whole budget"


def test_the_pose_is_that_of_the_sender(toy_env: Make) -> None:
    """The maps' poses to the ego's, in units of 64 m; the ego stands at its own origin."""
    env = toy_env("none", attackers=(0, 1), max_frames=FRAMES)
    observations, _ = env.reset(seed=3, options={"scene": "toy-0", "start": 0})
    ego, other = (observations[agent]["context"][4:6] * 64 for agent in env.agents)
    assert ego == pytest.approx([0, 0])
    assert other == pytest.approx([-10, 0], abs=1.0), "10 m behind it, on a lattice of cells"


def test_feedback_before_the_first_frame_and_after(toy_env: Make) -> None:
    first, later = contexts(toy_env, "gray-box")[:, ROLE:], contexts(toy_env, "gray-box", steps=1)[:, ROLE:]
    assert first.tolist() == [[1, 0, 0, 0, 0, 0]] * 2
    similarity, damage, verifications, suspects, fused, _ = later[0]
    assert (similarity, damage, verifications, suspects, fused) == (1, 0, 0, 0, 1), "a frame of grace under no defence"


def test_the_white_box_names_the_attackers(toy_env: Make) -> None:
    insight = contexts(toy_env, "white-box")[:, ROLE + FEEDBACK :]
    assert insight[:, :N].tolist() == np.eye(N)[[1, 3]].tolist(), "which vehicle the slot itself drives"
    assert insight[:, N : 2 * N].tolist() == [[0, 1, 0, 1, 0]] * 2


@pytest.mark.parametrize("knowledge", KNOWLEDGE)
def test_compact_vectors_end_with_a_coarse_grid_of_the_senders_map(toy_env: Make, knowledge: str) -> None:
    context = contexts(toy_env, knowledge)
    env = toy_env("none", attackers=(1, 3), knowledge=knowledge, observation="compact", max_frames=FRAMES)
    compact, _ = env.reset(seed=3)
    vectors = np.stack([np.asarray(compact[agent]) for agent in env.agents])
    assert vectors.shape[1] == context.shape[1] + 16 and np.array_equal(vectors[:, :-16], context)
    assert vectors[:, -16:].any(1).all() and not np.array_equal(vectors[0, -16:], vectors[1, -16:])
