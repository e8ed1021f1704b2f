"""The video of one run."""

from __future__ import annotations

import itertools

import agents
from cp_env.evaluation import Run
from cp_env.evaluation.report.video import render_episode
from tests.helpers.toy_evaluation import CONDITIONS, toy_bank


def test_a_film_has_a_picture_for_every_frame() -> None:
    run = Run("prbi", "pgd:steps=1", 2, 0, ("toy-1",))
    pictures = render_episode(run, CONDITIONS, toy_bank(), agents.make)
    assert len(pictures) == CONDITIONS.frames
    assert len(render_episode(run, CONDITIONS, toy_bank(), agents.make, frames=2)) == 2
    assert any((a != b).any() for a, b in itertools.pairwise(pictures))
