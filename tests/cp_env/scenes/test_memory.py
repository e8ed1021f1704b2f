"""Memory is bounded by what is played: no reader keeps the points of a frame that was given.

`python -m benchmarks.memory` measures it on scenarios of 60,000 points a sweep.
"""

from __future__ import annotations

import gc
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import pytest

from cp_env.scenes import open_source
from cp_env.scenes.export import export
from cp_env.scenes.opv2v import writer
from tests.helpers import dair_sets, nuscenes_sets
from tests.helpers.coperception_files import write_files
from tests.helpers.toy_scenes import ToySource

TOY = ToySource(n_frames=6, n_connected=2)
NAMES = ["scene-0061", "scene-0103"]
SETS: dict[str, Callable[[Path], object]] = {
    "opv2v": lambda root: export(TOY, root, layout="opv2v"),
    "v2x-sim": lambda root: export(TOY, root),
    "v2x-sim-det": lambda root: write_files(TOY, root, "test", {"toy-0": 5}),
    "v2v4real": lambda root: writer.write(TOY, TOY.names(), root, kind="v2v4real"),
    "v2x-real": lambda root: writer.write(TOY, TOY.names(), root, kind="v2x-real"),
    "dair-v2x": lambda root: dair_sets.write_set(TOY, root),
    "nuscenes": lambda root: nuscenes_sets.write_set(TOY, root, NAMES),
}


@pytest.mark.parametrize("kind", SETS)
def test_frames_that_were_given_are_not_kept(kind: str, tmp_path: Path) -> None:
    """After five more frames less is in memory than the points of one."""
    SETS[kind](tmp_path / "set")
    source = open_source(f"{kind}:{tmp_path / 'set'}")
    scene = source.load(source.names()[0])
    one = sum(sweep.points.nbytes for sweep in source.sweeps(scene, [0])[0])
    gc.collect()
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        for t in range(1, scene.n_frames):
            source.sweeps(scene, [t])
        gc.collect()
        kept = tracemalloc.get_traced_memory()[0] - before
    finally:
        tracemalloc.stop()
    assert scene.n_frames >= 3 and kept < one / 2
