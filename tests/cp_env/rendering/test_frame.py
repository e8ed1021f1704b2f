"""The picture of a frame: what it shows, and where it shows it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from cp_env.rendering import frame, panel
from cp_env.rendering.frame import draw, draw_output
from cp_env.rendering.panel import Image3
from cp_env.rendering.picture import Picture
from tests.helpers.drawn_frames import NOTHING, boxes, colours_in, detections

BOTH = ((frame.LEFT, frame.TOP), (frame.RIGHT, frame.TOP))
ALONE = (frame.LEFT, frame.ALONE_TOP)


def changed(a: Picture, b: Picture, drawn: Callable[[Picture], Image3] = draw) -> np.ndarray:
    """Which pixels differ between the two pictures."""
    return (drawn(a) != drawn(b)).any(axis=-1)


@pytest.mark.parametrize(("drawn", "size"), [(draw, frame.SIZE), (draw_output, frame.ALONE_SIZE)])
def test_a_picture_is_an_image_of_fixed_size_and_the_same_each_time(
    drawn: Callable[[Picture], Image3], size: tuple[int, int]
) -> None:
    image = drawn(NOTHING)
    assert image.dtype == np.uint8
    assert image.shape == (size[1], size[0], 3)
    assert (drawn(NOTHING) == image).all()


def test_the_image_of_both_is_as_wide_as_a_page_and_two_of_the_output_fit_side_by_side() -> None:
    assert frame.SIZE[0] == 690 and 2 * frame.ALONE_SIZE[0] <= 690


@pytest.mark.parametrize(("x", "y"), [(20.0, 10.0), (-20.0, 10.0), (20.0, -25.0), (-7.0, -7.0)])
def test_found_missed_and_ghost_have_their_colours_where_they_are(x: float, y: float) -> None:
    found = replace(NOTHING, truth=boxes((x, y)), seen=detections((x, y)), output=detections((x, y)))
    half = draw(replace(NOTHING, truth=boxes((x, y)), output=detections((x, y))))
    ghost = draw(replace(NOTHING, seen=detections((x, y))))
    for image, corner, side in (
        (draw(found), BOTH[0], frame.SIDE),
        (draw(found), BOTH[1], frame.SIDE),
        (draw_output(found), ALONE, frame.ALONE_SIDE),
    ):
        colours = colours_in(image, corner, side, x, y)
        assert {panel.TRUE, panel.SEEN} <= colours and not {panel.MISSED, panel.GHOST} & colours
    left, right = (colours_in(half, corner, frame.SIDE, x, y) for corner in BOTH)
    assert panel.MISSED in left and panel.TRUE in right
    left, right = (colours_in(ghost, corner, frame.SIDE, x, y) for corner in BOTH)
    assert panel.GHOST in left and panel.GHOST not in right


def test_attackers_are_ringed_in_both_panels_and_suspects_crossed_in_the_defended_one() -> None:
    picture = replace(
        NOTHING,
        points=[],
        places=np.array([[0.0, 0.0], [12.0, 5.0], [-12.0, 5.0]]),
        attackers=frozenset({1}),
        suspects=frozenset({2}),
        collaborators=frozenset({0, 1}),
    )
    image = draw(picture)
    for corner in BOTH:
        assert panel.ATTACKER in colours_in(image, corner, frame.SIDE, 12.0, 5.0)
        assert panel.ATTACKER not in colours_in(image, corner, frame.SIDE, -12.0, 5.0)
        assert panel.SUSPECT not in colours_in(image, corner, frame.SIDE, 12.0, 5.0)
    assert panel.SUSPECT not in colours_in(image, BOTH[0], frame.SIDE, -12.0, 5.0)
    assert panel.SUSPECT in colours_in(image, BOTH[1], frame.SIDE, -12.0, 5.0)


def test_what_is_out_of_range_changes_nothing_outside_the_panels_and_their_counts() -> None:
    far = np.array([[0.0, 0.0], [100.0, 3.0], [100.0, 3.0], [101.0, 3.0], [3.0, -90.0]])
    here = replace(NOTHING, points=[], places=far * 0.01)
    there = replace(here, places=far, points=[np.array([[40.0, 0.0, 1.0], [0.0, -33.0, 1.0]])])
    difference = changed(replace(there, seen=detections((31.0, 31.0), (-32.0, 0.0))), here)
    allowed = np.zeros_like(difference)
    for left, top in BOTH:
        allowed[top - 1 : top + frame.SIDE + 1, left - 1 : left + frame.SIDE + 1] = True
        allowed[top + frame.SIDE : top + frame.SIDE + 26, left : left + frame.SIDE] = True
    assert difference.any() and not (difference & ~allowed).any()


def test_the_strip_shows_the_similarities_so_far() -> None:
    one = replace(NOTHING, similarity=(float("nan"), 0.9))
    two = replace(NOTHING, similarity=(float("nan"), 0.9, 0.2))
    rows, columns = np.nonzero(changed(one, two))
    below = rows > frame.BELOW
    assert below.any()
    assert columns[below].min() >= frame.RIGHT - 4
    assert changed(one, replace(one, threshold=0.35)).any()
    rows, _ = np.nonzero(changed(one, two, draw_output))
    assert rows.min() >= frame.ALONE_STRIP - 4 and rows.max() < frame.ALONE_LEGEND - 10


@pytest.mark.parametrize("drawn", [draw, draw_output])
def test_scene_attack_defence_and_frame_are_written_above_the_panels(drawn: Callable[[Picture], Image3]) -> None:
    named = replace(NOTHING, title="scene", attack="pgd", defence="prbi")
    top = frame.TOP if drawn is draw else frame.ALONE_TOP
    for other in (
        replace(named, title="other"),
        replace(named, attack="ramp"),
        replace(named, defence="none"),
        replace(named, frame=9),
    ):
        rows, _ = np.nonzero(changed(named, other, drawn))
        assert len(rows) and rows.max() < top


@pytest.mark.parametrize("drawn", [draw, draw_output])
def test_long_names_end_before_the_edge(drawn: Callable[[Picture], Image3]) -> None:
    long = replace(NOTHING, title="scene" * 40, attack="policy:" * 40, defence="bayes:" * 40)
    image = drawn(long)
    assert (image[:, -7:] == panel.GROUND).all(), "the right margin stays empty"
