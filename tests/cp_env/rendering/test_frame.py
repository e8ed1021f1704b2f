"""The picture of a frame: what it shows, where it shows it, and what it costs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cp_env.rendering import frame
from cp_env.rendering.frame import Picture, draw, write_gif, wrong_rows
from cp_env.types import Detections

CAR = (4.5, 1.8, 0.3)


def boxes(*centres: tuple[float, float]) -> np.ndarray:
    return np.array([(x, y, *CAR) for x, y in centres]).reshape(-1, 5)


def detections(*centres: tuple[float, float]) -> Detections:
    return Detections(boxes(*centres), np.ones(len(centres)))


NOTHING = Picture(
    frame=3,
    points=[np.zeros((0, 3))],
    places=np.zeros((1, 2)),
    truth=boxes(),
    seen=detections(),
    output=detections(),
    attackers=frozenset(),
    suspects=frozenset(),
    collaborators=frozenset({0}),
    similarity=(),
    verifications=0,
    damage=0.0,
)


def changed(a: Picture, b: Picture) -> np.ndarray:
    """Which pixels differ between the two pictures."""
    return (draw(a) != draw(b)).any(axis=-1)


def colours_in(image: np.ndarray, left: int, x: float, y: float, radius: int = 16) -> set[tuple[int, ...]]:
    """The colours around a point of the panel at `left`, worked out by hand: 400 pixels are 64 m, north is up."""
    column, row = int(left + (x + 32) * 400 / 64), int(frame.TOP + (32 - y) * 400 / 64)
    patch = image[max(row - radius, 0) : row + radius, max(column - radius, 0) : column + radius].reshape(-1, 3)
    return {tuple(int(v) for v in pixel) for pixel in patch}


def test_a_picture_is_an_image_of_fixed_size_and_the_same_each_time() -> None:
    image = draw(NOTHING)
    assert image.dtype == np.uint8
    assert image.shape == (frame.SIZE[1], frame.SIZE[0], 3)
    assert (draw(NOTHING) == image).all()


@pytest.mark.parametrize(("x", "y"), [(20.0, 10.0), (-20.0, 10.0), (20.0, -25.0), (-7.0, -7.0)])
def test_found_missed_and_ghost_have_their_colours_where_they_are(x: float, y: float) -> None:
    found = draw(replace(NOTHING, truth=boxes((x, y)), seen=detections((x, y)), output=detections((x, y))))
    half = draw(replace(NOTHING, truth=boxes((x, y)), output=detections((x, y))))
    ghost = draw(replace(NOTHING, seen=detections((x, y))))
    for left in (frame.LEFT, frame.RIGHT):
        assert {frame.TRUE, frame.SEEN} <= colours_in(found, left, x, y)
        assert not {frame.MISSED, frame.GHOST} & colours_in(found, left, x, y)
    assert frame.MISSED in colours_in(half, frame.LEFT, x, y)
    assert frame.TRUE in colours_in(half, frame.RIGHT, x, y)
    assert frame.GHOST in colours_in(ghost, frame.LEFT, x, y)
    assert frame.GHOST not in colours_in(ghost, frame.RIGHT, x, y)


def test_points_lie_where_they_were_measured_and_the_ego_s_on_top() -> None:
    standing, ground = np.array([[10.0, 20.0, 1.0]]), np.array([[10.0, -20.0, 0.0]])
    picture = replace(NOTHING, points=[standing, np.concatenate([standing, ground])], places=np.zeros((2, 2)))
    image = draw(picture)
    for left in (frame.LEFT, frame.RIGHT):
        assert frame.EGO in colours_in(image, left, 10.0, 20.0, radius=2)
        assert frame.OTHERS not in colours_in(image, left, 10.0, 20.0, radius=2)
        assert frame.STREET in colours_in(image, left, 10.0, -20.0, radius=2)


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
    for left in (frame.LEFT, frame.RIGHT):
        assert frame.ATTACKER in colours_in(image, left, 12.0, 5.0)
        assert frame.ATTACKER not in colours_in(image, left, -12.0, 5.0)
        assert frame.SUSPECT not in colours_in(image, left, 12.0, 5.0)
    assert frame.SUSPECT not in colours_in(image, frame.LEFT, -12.0, 5.0)
    assert frame.SUSPECT in colours_in(image, frame.RIGHT, -12.0, 5.0)


def test_what_is_out_of_range_stays_inside_its_panel() -> None:
    """A box, points and vehicles beyond the edge change nothing outside the panels, and no marker is lost."""
    far = np.array([[0.0, 0.0], [100.0, 3.0], [100.0, 3.0], [101.0, 3.0], [3.0, -90.0]])
    here = replace(NOTHING, points=[], places=far * 0.01)
    there = replace(here, places=far, points=[np.array([[40.0, 0.0, 1.0], [0.0, -33.0, 1.0]])])
    difference = changed(replace(there, seen=detections((31.0, 31.0), (-32.0, 0.0))), here)
    panels = np.zeros_like(difference)
    for left in (frame.LEFT, frame.RIGHT):
        panels[frame.TOP - 1 : frame.TOP + 401, left - 1 : left + 401] = True
    caption = np.zeros_like(difference)
    caption[frame.TOP - 30 : frame.TOP - 1] = True
    assert difference.any()
    assert not (difference & ~panels & ~caption).any()

    markers = frame._markers(there)
    spots = np.array([(x, y) for x, y, _ in markers])
    apart = np.linalg.norm(spots[:, None] - spots[None], axis=-1) + 100 * np.eye(len(spots))
    assert apart.min() >= 20
    assert [any(outward) for _, _, outward in markers] == [False, True, True, True, True]


def test_the_strip_shows_the_similarities_so_far() -> None:
    one = replace(NOTHING, similarity=(float("nan"), 0.9))
    two = replace(NOTHING, similarity=(float("nan"), 0.9, 0.2))
    rows, columns = np.nonzero(changed(one, two))
    below = rows > frame.STRIP_TOP
    assert below.any()
    assert columns[below].min() >= frame.RIGHT - 4
    assert changed(one, replace(one, threshold=0.35)).any()


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


def test_a_gif_plays_every_frame_and_needs_one(tmp_path: Path) -> None:
    picture = replace(NOTHING, attackers=frozenset({0}), suspects=frozenset({0}), seen=detections((20, 20)))
    frames = [draw(replace(picture, frame=t, truth=boxes((t, 9)))) for t in range(6)]
    path = write_gif(frames, tmp_path / "deep" / "episode.gif", fps=5)
    with Image.open(path) as gif:
        assert gif.n_frames == 6
        assert gif.info["loop"] == 0
        assert gif.info["duration"] == 200
        gif.seek(5)
        shown = np.asarray(gif.convert("RGB")).astype(int)
    assert np.abs(shown - frames[5]).mean() < 2
    for colour in (
        frame.ATTACKER,
        frame.SUSPECT,
        frame.GHOST,
        frame.MISSED,
        frame.TRUE,
        frame.SEEN,
    ):
        assert ((shown == colour).all(-1) == (frames[5] == colour).all(-1)).all()
    with pytest.raises(ValueError, match="at least one frame"):
        write_gif([], tmp_path / "none.gif")
