"""LiDAR and grid on real traffic, one torch thread: at most 40 ms for the five sweeps of a frame, 1.5 ms for a grid."""

from __future__ import annotations

import dataclasses

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from cp_env import lidar
from cp_env.detector.model import bev
from cp_env.scenes import open_source
from cp_env.types import Scene


@pytest.fixture(scope="module")
def five() -> Scene:
    """The test scene with the most vehicles, with its first five radios and no road-side unit."""
    source = open_source("town/test")
    scene = max((source.load(name) for name in source.names()), key=lambda s: len(s.size))
    return dataclasses.replace(scene, connected=scene.connected[:5], rsu=None)


def test_sweeps_of_five_vehicles_in_one_frame(benchmark: BenchmarkFixture, five: Scene) -> None:
    benchmark(lidar.scan, [(five, 50)])


def test_sweeps_of_five_vehicles_in_sixteen_frames(benchmark: BenchmarkFixture, five: Scene) -> None:
    benchmark(lidar.scan, [(five, frame) for frame in range(16)])


def test_grids_of_five_sweeps(benchmark: BenchmarkFixture, five: Scene) -> None:
    benchmark(bev.rasterise, lidar.scan([(five, 50)])[0])


def test_unpacking_forty_grids(benchmark: BenchmarkFixture, five: Scene) -> None:
    packed = bev.pack(bev.rasterise(lidar.scan([(five, 50)])[0] * 8))
    benchmark(bev.unpack, packed)
