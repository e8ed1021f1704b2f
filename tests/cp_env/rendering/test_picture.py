"""The content of a picture: what was missed, what is a ghost, and which frame tells most."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cp_env.rendering.picture import standing_points, telling_frame, wrong_rows
from tests.helpers.drawn_frames import NOTHING, boxes, detections


@pytest.mark.parametrize(
    ("seen", "truth", "ghosts", "missed"),
    [
        (boxes(), boxes(), set(), set()),
        (boxes((5, 5)), boxes(), {0}, set()),
        (boxes(), boxes((5, 5)), set(), {0}),
        (boxes((5, 5), (9, 9)), boxes((20, 0), (5.2, 5)), {1}, {0}),
        (boxes((5, 5), (5, 5)), boxes((5, 5)), {1}, set()),
    ],
)
def test_wrong_rows_by_hand(seen: np.ndarray, truth: np.ndarray, ghosts: set[int], missed: set[int]) -> None:
    assert wrong_rows(seen, truth)[1] == missed
    assert len(wrong_rows(seen, truth)[0]) == len(ghosts)


def test_the_telling_frame_is_where_the_defence_corrects_most() -> None:
    benign = replace(NOTHING, truth=boxes((5, 5)), seen=detections((5, 5)), output=detections((5, 5)))
    attacked = replace(benign, seen=detections((5, 5), (20, 20), (-20, 20)), output=detections((5, 5), (20, 20)))
    corrected = replace(attacked, output=detections((5, 5)))
    assert telling_frame([benign, attacked, corrected, benign, corrected]) == 2
    undefended = replace(attacked, output=attacked.seen)
    worse = replace(undefended, seen=detections((20, 20), (-20, 20)), output=detections((20, 20), (-20, 20)))
    assert telling_frame([benign, undefended, worse]) == 2, "without a correction, the frame with most errors"
    assert telling_frame([benign]) == 0


def test_standing_points_are_those_above_the_ground() -> None:
    points = np.array([[1.0, 2.0, 0.0], [1.0, 2.0, 0.31], [3.0, 4.0, 1.5]])
    (kept,) = standing_points(replace(NOTHING, points=[points])).points
    assert kept.tolist() == points[1:].tolist()


@pytest.mark.parametrize(
    ("defence", "words"), [("", "defended"), ("none", "no defence"), ("prbi:w=4", "defended by prbi:w=4")]
)
def test_the_defence_in_words(defence: str, words: str) -> None:
    assert replace(NOTHING, defence=defence).defended == words
