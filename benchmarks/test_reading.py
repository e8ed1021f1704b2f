"""Reading a frame of five vehicles from disk (warm), one thread: at most 50 ms, in any layout; opening a set again.

DAIR-V2X has a vehicle and a unit, nuScenes one vehicle: five sweeps are those of several frames there. `opv2v-hill` is
a set whose vehicles stand at different heights. Sparse are the town's own sensors, some thousands of returns each;
dense are 64 beams and about 60,000 returns. Time is the processor's: other programs' share of it does not count.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from cp_env import lidar
from cp_env.scenes import Town, open_source
from cp_env.scenes.clip import Clip
from cp_env.scenes.export import export
from cp_env.scenes.opv2v import writer
from cp_env.types import Scene, SceneSource, Sweep
from tests.helpers import dair_sets, nuscenes_sets
from tests.helpers.coperception_files import write_files
from tests.helpers.hills import lift_opv2v

pytestmark = pytest.mark.benchmark(timer=time.process_time)
FRAMES = 4


class Dense(Clip):
    """Sensors like those of OPV2V."""

    def sweeps(self, scene: Scene, frames: Sequence[int]) -> list[list[Sweep]]:
        spec = lidar.LidarSpec(elevations=lidar.fan(-24.0, 3.0, 64), azimuths=1024)
        return lidar.scan([(scene, int(frame)) for frame in frames], vehicle_spec=spec)


class OneScene(Clip):
    """One scene of a source."""

    def __init__(self, source: SceneSource, name: str) -> None:
        super().__init__(source)
        self._name = name

    def names(self) -> tuple[str, ...]:
        return (self._name,)


@pytest.fixture(scope="module", params=[Clip, Dense], ids=["sparse", "dense"])
def town(request: pytest.FixtureRequest) -> tuple[SceneSource, str]:
    """The first frames of the test scene with the most vehicles, five radios."""
    source = request.param(Town("test"), frames=FRAMES, vehicles=5)
    return source, max(source.names(), key=lambda name: len(source.load(name).size))


LAYOUTS = (
    "v2x-sim",
    "v2x-sim-det",
    "opv2v",
    "opv2v-ascii",
    "opv2v-hill",
    "v2v4real",
    "v2x-real",
    "dair-v2x",
    "nuscenes",
)


@pytest.fixture(scope="module", params=LAYOUTS)
def spec(
    request: pytest.FixtureRequest, town: tuple[SceneSource, str], tmp_path_factory: pytest.TempPathFactory
) -> str:
    (source, name), layout = town, request.param
    root: Path = tmp_path_factory.mktemp("reading") / "set"
    if layout == "v2x-sim-det":
        write_files(source, root, "test", {name: 5})
    elif layout == "opv2v-ascii":
        writer.write(source, [name], root, data="ascii")
    elif layout == "opv2v-hill":
        lift_opv2v(export(source, root, layout="opv2v", names=[name]))
    elif layout in ("v2v4real", "v2x-real"):
        writer.write(source, [name], root, kind=layout)
    elif layout == "dair-v2x":
        return f"dair-v2x:{dair_sets.write_set(OneScene(source, name), root)}?stride=1"
    elif layout == "nuscenes":
        nuscenes_sets.write_set(OneScene(source, name), root, ["scene-0061"])
    else:
        export(source, root, layout=layout, names=[name])
    return f"{layout.removesuffix('-ascii').removesuffix('-hill')}:{root}"


def test_a_frame_of_five_vehicles(benchmark: BenchmarkFixture, spec: str) -> None:
    source = open_source(spec)
    scene = source.load(source.names()[0])
    agents = scene.n_connected + (scene.rsu is not None)
    frame, at_once = iter(range(10**9)), -(-5 // agents)  # five sweeps, of several frames where a frame has fewer
    sweeps = benchmark(lambda: source.sweeps(scene, [next(frame) % FRAMES for _ in range(at_once)]))
    assert sum(len(row) for row in sweeps) >= 5


def test_opening_a_set_again(benchmark: BenchmarkFixture, spec: str) -> None:
    open_source(spec)
    benchmark(open_source, spec)
