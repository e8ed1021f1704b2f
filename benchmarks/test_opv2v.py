"""Reading OPV2V from disk: the sweeps of five vehicles of one frame take at most 50 ms on one thread."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from cp_env import lidar
from cp_env.scenes import Town, pcd
from cp_env.scenes.clip import Clip
from cp_env.scenes.opv2v import OPV2V
from cp_env.scenes.opv2v_writer import write


class Dense(Clip):
    """Sensors of 64 beams and about 60,000 returns, as OPV2V's."""

    def sweeps(self, scene, frames):
        spec = lidar.LidarSpec(elevations=lidar.fan(-24.0, 3.0, 64), azimuths=1024)
        return lidar.scan([(scene, int(frame)) for frame in frames], rsu=False, vehicle_spec=spec)

    def load(self, name):
        return replace(super().load(name), rsu=None)


@pytest.mark.parametrize("data", pcd.ENCODINGS)
def test_a_frame_of_five_vehicles(benchmark: BenchmarkFixture, tmp_path: Path, data: str) -> None:
    source = Dense(Town("test"), frames=2, vehicles=5)
    name = source.names()[0]
    write(source, [name], tmp_path, data=data)
    back = OPV2V(tmp_path)
    scene = back.load(name)
    (sweeps,) = benchmark(back.sweeps, scene, [1])
    assert len(sweeps) == 5 and min(len(sweep.points) for sweep in sweeps) > 50_000
    if data == "binary" and benchmark.stats is not None:
        assert benchmark.stats["min"] <= 0.05
