"""Several sources as one."""

from __future__ import annotations

import numpy as np
import pytest

from cp_env.scenes import open_source
from cp_env.scenes.pooled import Pooled
from cp_env.types import SceneSource
from tests.helpers.toy_scenes import ToySource

TEXT = "town/calibration+junction/calibration"


def test_a_pool_holds_the_scenes_of_all_in_order() -> None:
    parts = [open_source(text) for text in TEXT.split("+")]
    pool = open_source(TEXT)
    assert isinstance(pool, SceneSource) and pool.name == TEXT
    assert pool.names() == parts[0].names() + parts[1].names()
    for part in parts:
        assert pool.load(part.names()[0]) is part.load(part.names()[0])
    backwards = open_source("+".join(reversed(TEXT.split("+"))))
    assert len({pool.digest, backwards.digest, parts[0].digest, parts[1].digest}) == 4
    assert open_source(TEXT).digest == pool.digest


def test_sweeps_are_those_of_the_scenes_own_source() -> None:
    toy = ToySource(n_frames=2)
    pool = Pooled([open_source("town/test"), toy])
    scene = pool.load(toy.names()[0])
    for ours, theirs in zip(pool.sweeps(scene, [1]), toy.sweeps(scene, [1]), strict=True):
        assert all(np.array_equal(a.points, b.points) for a, b in zip(ours, theirs, strict=True))


def test_bad_pools_are_refused() -> None:
    with pytest.raises(ValueError, match="name one"):
        Pooled([])
    with pytest.raises(ValueError, match="same name"):
        Pooled([open_source("town/test")] * 2)
    with pytest.raises(ValueError, match=r"unknown scene 'x'.*holds calibration-urban-00"):
        open_source(TEXT).load("x")
    for text in ("town/test+", "town/test+city", "+town"):
        with pytest.raises(ValueError, match="town/test"):
            open_source(text)
