"""Visibility statistics of a scene."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cp_env.lidar.returns import returns_of
from cp_env.scenes.preview import film
from tests.cp_env.scenes.preview.test_film import SCENE, Three, sweep


def test_who_is_seen_is_counted_by_hand() -> None:
    figures = film.figures(Three(), "three", [0, 1])
    assert figures.seen_by_ego.tolist() == [0, 0.5, 0]
    assert figures.seen.tolist() == [0, 0.5, 1], "row 2 is there in one frame, and seen in it"
    assert figures.present.tolist() == [3, 2] and figures.points.tolist() == [[3, 3], [1, 1]]
    assert np.allclose(figures.nearest, [0, np.hypot(20, 10), np.hypot(20, 10)])
    assert figures.reach[1, 0] == pytest.approx(np.hypot(5, 5))
    with pytest.raises(ValueError, match="at least one frame"):
        film.figures(Three(), "three", [])


def test_hits_of_the_source_are_taken_before_boxes() -> None:
    known = replace(sweep(0, 0, [[5, 5, 0.0]]), hits=np.array([0, 7, 0]))
    assert returns_of(SCENE, 0, known).tolist() == [0, 7, 0]
