"""Classes of vehicles, told or guessed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from cp_env.scenes.preview.classes import NamesClasses, classes_of
from cp_env.types import Scene
from tests.helpers.toy_scenes import ToySource


class Named(ToySource):
    def classes(self, scene: Scene) -> Sequence[str]:
        return ["vehicle.car"] * 13 + ["vehicle.tram"]


def test_a_source_that_knows_is_asked() -> None:
    source = Named()
    names, told = classes_of(source, source.load("toy-0"))
    assert (
        isinstance(source, NamesClasses) and told and names.count("vehicle.car") == 13 and names[13] == "vehicle.tram"
    )


def test_one_that_does_not_is_guessed_at() -> None:
    """A truck is longer than 6.5 m and higher than 3 m, a bus longer than 10 m."""
    source = ToySource()
    scene = source.load("toy-0")
    sizes = [(4.5, 1.8, 1.5), (8.5, 2.5, 3.4), (7.0, 2.2, 2.5), (12.0, 2.5, 2.9)]
    names, told = classes_of(source, replace(scene, size=np.array(sizes * 3 + sizes[:2])))
    assert not isinstance(source, NamesClasses) and not told
    assert names[:4] == ("car", "truck", "car", "bus")


def test_one_name_a_vehicle() -> None:
    scene = ToySource().load("toy-0")
    with pytest.raises(ValueError, match="names 14 classes for the 13 vehicles of scene toy-0"):
        classes_of(Named(), replace(scene, pose=scene.pose[:, :13], size=scene.size[:13]))
