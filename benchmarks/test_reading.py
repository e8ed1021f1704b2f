"""Reading a frame of five vehicles from disk (warm), one thread: at most 50 ms, in any layout; opening a set again."""

from __future__ import annotations

from pathlib import Path

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from cp_env.scenes import Town, open_source
from cp_env.scenes.clip import Clip
from cp_env.scenes.export import export
from cp_env.types import SceneSource
from tests.reference.coperception_files import write_files

FRAMES = 4


@pytest.fixture(scope="module")
def town() -> tuple[SceneSource, str]:
    """The first frames of the test scene with the most vehicles, five radios."""
    source = Clip(Town("test"), frames=FRAMES, vehicles=5)
    return source, max(source.names(), key=lambda name: len(source.load(name).size))


@pytest.fixture(scope="module", params=["v2x-sim", "v2x-sim-det", "opv2v"])
def spec(
    request: pytest.FixtureRequest, town: tuple[SceneSource, str], tmp_path_factory: pytest.TempPathFactory
) -> str:
    source, name = town
    root: Path = tmp_path_factory.mktemp("reading") / "set"
    if request.param == "v2x-sim-det":
        write_files(source, root, "test", {name: 5})
    else:
        export(source, root, layout=request.param, names=[name])
    return f"{request.param}:{root}"


def test_a_frame_of_five_vehicles(benchmark: BenchmarkFixture, spec: str) -> None:
    source = open_source(spec)
    scene = source.load(source.names()[0])
    frame = iter(range(10**9))
    sweeps = benchmark(lambda: source.sweeps(scene, [next(frame) % FRAMES]))
    assert len(sweeps[0]) >= 5


def test_opening_a_set_again(benchmark: BenchmarkFixture, spec: str) -> None:
    open_source(spec)
    benchmark(open_source, spec)
