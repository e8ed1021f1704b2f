"""Films: every frame, the pictures' own colours, and the frame that comes first."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cp_env.rendering import frame, panel
from cp_env.rendering.frame import draw
from cp_env.rendering.gif import write_gif
from tests.helpers.drawn_frames import NOTHING, boxes, detections

MARKS = (panel.ATTACKER, panel.SUSPECT, panel.GHOST, panel.MISSED, panel.TRUE, panel.SEEN)


@pytest.fixture(scope="module")
def frames() -> list[np.ndarray]:
    picture = replace(NOTHING, attackers=frozenset({0}), suspects=frozenset({0}), seen=detections((20, 20)))
    return [draw(replace(picture, frame=t, truth=boxes((t, 9)))) for t in range(6)]


def test_a_gif_plays_every_frame_and_needs_one(frames: list[np.ndarray], tmp_path: Path) -> None:
    path = write_gif(frames, tmp_path / "deep" / "episode.gif", fps=5)
    with Image.open(path) as gif:
        assert gif.n_frames == 6
        assert gif.info["loop"] == 0
        assert gif.info["duration"] == 200
        gif.seek(5)
        shown = np.asarray(gif.convert("RGB")).astype(int)
    assert np.abs(shown - frames[5]).mean() < 2
    panels = slice(frame.TOP, frame.TOP + frame.SIDE)  # below them are texts in the same colours, with soft edges
    for colour in MARKS:
        kept, drawn = ((image == colour).all(-1) for image in (shown, frames[5]))
        assert (kept[panels] == drawn[panels]).all() and kept[drawn].all()
    with pytest.raises(ValueError, match="at least one frame"):
        write_gif([], tmp_path / "none.gif")


def test_the_loop_begins_where_it_is_told(frames: list[np.ndarray], tmp_path: Path) -> None:
    """A GIF's first frame is what is shown where it does not play."""
    with Image.open(write_gif(frames, tmp_path / "film.gif", first=4)) as gif:
        for position, number in enumerate((4, 5, 0, 1, 2, 3)):
            gif.seek(position)
            shown = np.asarray(gif.convert("RGB")).astype(int)
            assert np.abs(shown - frames[number]).mean() < 2 < np.abs(shown - frames[number - 1]).max()
    for first in (-1, 6):
        with pytest.raises(ValueError, match=f"one of the 6 frames, 0 to 5, got {first}"):
            write_gif(frames, tmp_path / "film.gif", first=first)
