"""Views worked out before they come about are those that the world then computes."""

from __future__ import annotations

import numpy as np
import torch

from cp_env.world.counterfactual import clean_views, damage, similarities, views_under
from cp_env.world.scene_cache import SceneBank
from cp_env.world.situation import Situation
from cp_env.world.world import World

EVERYONE = frozenset(range(5))


def started(bank: SceneBank, frames: int = 1) -> World:
    world = World(2, bank=bank, defender="none", attackers=(1, 3), grace_frames=0, max_frames=6)
    world.reset([3, 4])
    for _ in range(frames):
        world.step(drawn(world.situation()))
    return world


def drawn(situation: Situation, seed: int = 0) -> torch.Tensor:
    """A perturbation at the border of the ball."""
    generator = torch.Generator().manual_seed(seed)
    shape = (*situation.attackers.shape, *situation.received.shape[2:])
    return situation.budget * (2.0 * torch.randint(0, 2, shape, generator=generator) - 1)


def test_the_view_of_everyone_is_what_the_ego_then_sees(bank: SceneBank) -> None:
    world = started(bank)
    situation = world.situation()
    delta = drawn(situation, seed=1)
    views = views_under(situation, delta, [(e, EVERYONE) for e in range(2)])
    similarity, last = similarities(views, situation.output), damage(views, clean_views(situation))
    outcome = world.step(delta)
    np.testing.assert_allclose(similarity, outcome.similarity, atol=1e-6)
    np.testing.assert_allclose(last, outcome.damage, atol=1e-6)
    for view, seen, clean, plain in zip(views, outcome.seen, outcome.clean, clean_views(situation), strict=True):
        np.testing.assert_allclose(view.score_map, seen.score_map, atol=1e-5)
        assert (view.frame, view.group) == (seen.frame, seen.group) and np.array_equal(view.origin, seen.origin)
        np.testing.assert_allclose(plain.score_map, clean.score_map, atol=2e-3)  # kept in half precision


def test_a_group_without_attackers_does_not_change_with_what_they_send(bank: SceneBank) -> None:
    situation = started(bank).situation()
    benign, mixed = frozenset({0, 2, 4}), frozenset({0, 1, 2})
    pairs = [(1, benign), (1, mixed)]
    still, moved = (views_under(situation, delta, pairs) for delta in (0 * drawn(situation), drawn(situation)))
    assert np.array_equal(still[0].score_map, moved[0].score_map)
    assert not np.array_equal(still[1].score_map, moved[1].score_map)


def test_views_come_in_the_order_asked_whatever_the_world(bank: SceneBank) -> None:
    situation = started(bank).situation()
    delta, pairs = drawn(situation), [(1, EVERYONE), (0, frozenset({0})), (1, frozenset({0, 3}))]
    together = views_under(situation, delta, pairs)
    for view, pair in zip(together, pairs, strict=True):
        (alone,) = views_under(situation, delta, [pair])
        np.testing.assert_allclose(view.score_map, alone.score_map, atol=1e-6)
        assert view.group == pair[1]


def test_without_a_reference_a_view_is_alike(bank: SceneBank) -> None:
    situation = started(bank, frames=0).situation()
    assert situation.output == (None, None)
    views = views_under(situation, drawn(situation), [(e, EVERYONE) for e in range(2)])
    assert similarities(views, situation.output).tolist() == [1, 1]
    assert damage(views, views).tolist() == [0, 0]
