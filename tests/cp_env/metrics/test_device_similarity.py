"""Similarities on a device are those of `metrics.similarity`."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from cp_env.metrics import device_similarity, similarity
from cp_env.types import View
from tests.cp_env.metrics.test_similarity import NOTHING, cars, crowd, view
from tests.helpers.pretended_device import pretended

CPU = torch.device("cpu")


def sets() -> tuple[list[np.ndarray], list[np.ndarray]]:
    """None, equal, apart, and crowds whose boxes have several candidates."""
    a = [NOTHING, cars((0, 0)), cars((0, 0), (9, 9)), NOTHING, *(crowd(n, n) for n in (4, 9, 20))]
    b = [NOTHING, cars((0.5, 0)), NOTHING, cars((3, 3)), *(crowd(n, 100 + n) for n in (6, 9, 12))]
    return a, b


@pytest.mark.parametrize("iou", [0.05, 0.5])
def test_jaccard_is_the_same_for_crowds_too(iou: float) -> None:
    a, b = sets()
    expected = similarity.jaccard_many(a, b, iou)
    assert device_similarity.jaccard_many(a, b, CPU, iou).tolist() == expected.tolist()
    assert 0 < expected[-1] < 1


def pairs() -> list[tuple[View, View]]:
    """Views of egos that stand, that move, and that have left the common ground."""
    a, b = sets()
    motions = [(0.0, 0.0), (2.0, -4.0), (30.0, 0.0), (0.0, 64.0)]
    rng = np.random.default_rng(0)
    far = [rng.uniform([-32, -32, 4, 1.8, -3], [32, 32, 5, 2.2, 3], (15, 5)) for _ in motions]
    crowds = [(view(one), view(other, 1, motions[i % 4])) for i, (one, other) in enumerate(zip(a, b, strict=True))]
    moved = [
        (view(one), view(one - np.array([*motion, 0, 0, 0]), 1, motion))
        for one, motion in zip(far, motions, strict=True)
    ]
    return crowds + moved


def test_views_of_a_moving_ego_are_compared_alike() -> None:
    expected = similarity.view_similarity_many(pairs())
    assert device_similarity.view_similarity_many(pairs(), CPU).tolist() == expected.tolist()
    assert expected[-4] == 1.0 and 0 < expected[-2] < 1 and expected[-1] == 0.0, "the last has no common ground"
    assert len(device_similarity.view_similarity_many([], CPU)) == 0


def test_each_kind_of_device_has_its_way() -> None:
    assert device_similarity.matching_on(CPU) == (similarity.view_similarity_many, similarity.jaccard_many)
    expected = similarity.view_similarity_many(pairs()), similarity.jaccard_many(*sets())
    with pretended():
        compare, jaccard = device_similarity.matching_on(torch.device("meta"))
        assert compare(pairs()).tolist() == expected[0].tolist() and jaccard(*sets()).tolist() == expected[1].tolist()


def test_sets_are_padded() -> None:
    boxes, there = device_similarity.padded([cars((1, 2)), NOTHING, cars((3, 4), (5, 6))], CPU)
    assert boxes.shape == (3, 2, 5) and there.tolist() == [[True, False], [False, False], [True, True]]
    assert boxes[2, 1, 0] == 5 and not boxes[1].any()
