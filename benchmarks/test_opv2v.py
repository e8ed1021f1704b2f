"""Reading OPV2V from disk: the sweeps of five vehicles of one frame, 60,000 points each; the goal is 50 ms a frame."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from cp_env import lidar
from cp_env.scenes import Town, pcd
from cp_env.scenes.clip import Clip
from cp_env.scenes.opv2v import OPV2V
from cp_env.scenes.opv2v_writer import write
from cp_env.types import Scene, Sweep


class Dense(Clip):
    """Sensors of 64 beams and about 60,000 returns, among some dozens of driving vehicles, as in OPV2V."""

    def load(self, name: str) -> Scene:
        scene = super().load(name)
        whole = self._source.load(name).pose[..., :2]
        driving = np.flatnonzero(~(np.ptp(whole, axis=0) == 0).all(axis=1))
        pose, size = scene.pose[:, driving], scene.size[driving]
        return replace(scene, pose=pose, size=size, connected=np.searchsorted(driving, scene.connected), rsu=None)

    def sweeps(self, scene: Scene, frames: Sequence[int]) -> list[list[Sweep]]:
        spec = lidar.LidarSpec(elevations=lidar.fan(-24.0, 3.0, 64), azimuths=1024)
        return lidar.scan([(scene, int(frame)) for frame in frames], vehicle_spec=spec)


@pytest.mark.benchmark(timer=time.process_time)  # of the thread: other programs' share of the machine does not count
@pytest.mark.parametrize("data", pcd.ENCODINGS)
def test_a_frame_of_five_vehicles(benchmark: BenchmarkFixture, tmp_path: Path, data: str) -> None:
    source = Dense(Town("test"), frames=2, vehicles=5)
    name = source.names()[0]
    write(source, [name], tmp_path, data=data)
    back = OPV2V(tmp_path)
    scene = back.load(name)
    (sweeps,) = benchmark(back.sweeps, scene, [1])
    assert len(sweeps) == 5 and min(len(sweep.points) for sweep in sweeps) > 50_000
