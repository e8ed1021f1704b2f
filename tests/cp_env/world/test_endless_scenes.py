"""Scenes without end do not fill the disk."""

from __future__ import annotations

from pathlib import Path

import pytest

from cp_env.detector import Detector
from cp_env.world.scene_cache import KEPT, SceneBank
from tests.helpers.toy_scenes import ToySource


class Endless(ToySource):
    endless = True


def test_endless_scenes_leave_the_disk(detector: Detector, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a source without end a bank keeps `KEPT` scenes, under a folder of its own that goes with it."""
    assert KEPT > 16, "more than worlds in lock-step"
    monkeypatch.setattr("cp_env.world.scene_cache.KEPT", 1)
    banks = [SceneBank(Endless(n_frames=2), detector, tmp_path, progress=False) for _ in range(2)]
    assert banks[0].root != banks[1].root
    first = banks[0].episode("toy-0", 2, False)
    before = first.maps("received", 1)
    banks[0].episode("toy-1", 2, False).encode()
    assert [path.name for path in banks[0].root.iterdir()] == ["toy-1"]
    assert (first.maps("received", 1) == before).all(), "whoever holds an episode keeps it"
    again = banks[0].episode("toy-0", 2, False)
    assert (again.maps("received", 1) == before).all()
    root = banks[0].root
    banks.pop(0)
    assert root.exists(), "an episode that is held may still be played"
    del first, again
    assert not root.exists()
    assert SceneBank(ToySource(n_frames=2), detector, tmp_path).root == root.parent, "others share theirs"
