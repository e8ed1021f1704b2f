"""The video of one run."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
from PIL import Image

import agents
from cp_env.evaluation import Run
from cp_env.evaluation.report.video import record_episode, write_film
from cp_env.rendering.frame import ALONE_SIZE, draw, draw_output
from cp_env.rendering.picture import standing_points, telling_frame
from tests.helpers.toy_evaluation import CONDITIONS, toy_bank

RUN = Run("prbi", "pgd:steps=1", 2, 0, ("toy-1",))


def test_an_episode_has_a_picture_for_every_frame_with_scene_defence_and_attack() -> None:
    pictures = record_episode(RUN, CONDITIONS, toy_bank(), agents.make)
    assert len(pictures) == CONDITIONS.frames
    assert len(record_episode(RUN, CONDITIONS, toy_bank(), agents.make, frames=2)) == 2
    assert {(p.title, p.defence, p.attack) for p in pictures} == {("toy-1", "prbi", "pgd:steps=1")}
    assert any((draw(a) != draw(b)).any() for a, b in itertools.pairwise(pictures))


def test_a_film_begins_with_its_telling_frame(tmp_path: Path) -> None:
    pictures = record_episode(RUN, CONDITIONS, toy_bank(), agents.make)
    path = write_film(pictures, tmp_path / "film.gif", layout=draw_output, every=2)
    with Image.open(path) as gif:
        assert gif.size == ALONE_SIZE and gif.n_frames == 2
        first = np.asarray(gif.convert("RGB")).astype(int)
    shown = [standing_points(picture) for picture in pictures[::2]]
    assert np.abs(first - draw_output(shown[telling_frame(shown)])).mean() < 2
