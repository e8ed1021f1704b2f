"""The parts of a picture: the ground, markers at the edge, boxes that differ in shape, texts that fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from PIL import Image, ImageDraw

from cp_env.rendering import panel
from cp_env.rendering.panel import Panel, draw_box, draw_ground, fitted, font, markers
from tests.helpers.drawn_frames import NOTHING, colours_in

SQUARE = Panel(left=10, top=20, side=320, extent=32.0)  # five pixels a metre


def test_pixels_by_hand() -> None:
    spots = SQUARE.pixels(np.array([-32.0, 0.0, 32.0]), np.array([32.0, 0.0, -32.0]))
    assert spots.tolist() == [[0, 0], [160, 160], [320, 320]], "x to the right, y up"


def test_points_lie_where_they_were_measured_and_the_ego_s_on_top() -> None:
    standing, ground = np.array([[10.0, 20.0, 1.0]]), np.array([[10.0, -20.0, 0.0]])
    picture = replace(NOTHING, points=[standing, np.concatenate([standing, ground])], places=np.zeros((2, 2)))
    canvas = np.zeros((360, 340, 3), np.uint8)
    draw_ground(canvas, picture, (SQUARE,))
    near = {y: colours_in(canvas, (10, 20), 320, 10.0, y, radius=2) for y in (20.0, -20.0)}
    assert panel.EGO in near[20.0] and panel.OTHERS not in near[20.0] and panel.STREET in near[-20.0]
    assert not canvas[:20].any() and not canvas[:, :10].any(), "nothing outside the panel"


def test_markers_beyond_the_edge_are_held_at_it_and_apart() -> None:
    far = np.array([[0.0, 0.0], [100.0, 3.0], [100.0, 3.0], [101.0, 3.0], [3.0, -90.0]])
    for scale in (1.0, 1.4):
        held = markers(replace(NOTHING, places=far), replace(SQUARE, scale=scale))
        spots = np.array([(x, y) for x, y, _ in held])
        apart = np.linalg.norm(spots[:, None] - spots[None], axis=-1) + 100 * np.eye(len(spots))
        assert apart.min() >= 20 * scale and (spots >= 13).all() and (spots <= 307).all()
        assert [any(outward) for _, _, outward in held] == [False, True, True, True, True]


def test_boxes_differ_in_shape_and_not_by_colour_alone() -> None:
    """The middle of a box: empty where it was found, filled where it is missed, crossed where it is a ghost."""
    inside = {}
    for kind in ("true", "found", "missed", "ghost"):
        image = Image.new("RGB", (60, 40), panel.GROUND)
        draw_box(ImageDraw.Draw(image), [(10, 10), (50, 10), (50, 30), (10, 30)], kind, 2)
        inside[kind] = np.asarray(image)[13:28, 13:48]
    drawn = {kind: (pixels != panel.GROUND).any(axis=-1).mean() for kind, pixels in inside.items()}
    assert drawn["true"] == drawn["found"] == 0 and drawn["missed"] == drawn["ghost"] == 1
    assert len(np.unique(inside["missed"].reshape(-1, 3), axis=0)) == 1
    crossed = (inside["ghost"] == panel.GHOST).all(axis=-1)
    assert crossed[7, 17] and crossed[0].any() and not crossed[7, 2]


def test_a_text_that_is_too_wide_ends_in_an_ellipsis() -> None:
    pen = ImageDraw.Draw(Image.new("RGB", (8, 8)))
    assert fitted(pen, "prbi", 14, 100) == "prbi"
    cut = fitted(pen, "bayes:max_verifications=8", 14, 100)
    assert cut.startswith("bayes:") and cut.endswith("…") and pen.textlength(cut, font(14)) <= 100
