"""Visibility statistics of a scene."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from cp_env.lidar.returns import returns_of
from cp_env.scenes.preview import film
from cp_env.scenes.preview.tables import tables
from tests.cp_env.scenes.preview.test_film import SCENE, Three, sweep


def test_who_is_seen_is_counted_by_hand() -> None:
    figures = film.figures(film.excerpt(Three(), "three", [0, 1]))
    assert figures.seen_by_ego.tolist() == [0, 0.5, 0]
    assert figures.seen.tolist() == [0, 0.5, 1], "row 2 is there in one frame, and seen in it"
    assert figures.present.tolist() == [3, 2] and figures.points.tolist() == [[3, 3], [1, 1]]
    assert np.allclose(figures.nearest, [0, np.hypot(20, 10), np.hypot(20, 10)])
    assert figures.reach[1, 0] == pytest.approx(np.hypot(5, 5))
    with pytest.raises(ValueError, match="at least one frame"):
        film.figures(film.excerpt(Three(), "three", []))


def test_hits_of_the_source_are_taken_before_boxes() -> None:
    known = replace(sweep(0, 0, [[5, 5, 0.0]]), hits=np.array([0, 7, 0]))
    assert returns_of(SCENE, 0, known).tolist() == [0, 7, 0]


def test_speeds_and_redundancy_by_hand() -> None:
    """The ego sees row 1 in the first frame, agent 1 row 2; in the second, rows 0 and 1 are there and seen by none."""
    figures = film.figures(film.excerpt(Three(), "three", [0, 1]))
    assert np.allclose(figures.redundancy, [2 / 5, 0])
    assert figures.speed.shape == (1, 3) and figures.speed[0, :2].tolist() == [0, 0] and np.isnan(figures.speed[0, 2])
    moving = replace(SCENE, pose=SCENE.pose + np.array([[[0.0, 0, 0]], [[0.6, 0.8, 0]]]))
    assert np.allclose(replace(figures, scene=moving).speed[0, :2], 5.0), "1 m in 0.2 s"


def test_guessed_classes_are_called_so(capsys: pytest.CaptureFixture[str]) -> None:
    figures = film.figures(film.excerpt(Three(), "three", [0]))
    assert not figures.told
    for table in tables(figures, 2):
        Console(width=200).print(table)
    assert "3 car (guessed from sizes)" in capsys.readouterr().out
