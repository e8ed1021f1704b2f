"""How fast the detector is on one torch thread: `pytest benchmarks/test_detector.py`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import torch

from cp_env.detector import Detector, load_detector
from cp_env.detector.model.bev import BEV, rasterise
from tests.helpers.toy_scenes import ToySource

N = 5
Benchmark = Callable[..., Any]


@pytest.fixture(scope="module")
def detector() -> Detector:
    return load_detector()


@pytest.fixture(scope="module")
def situation(detector: Detector) -> tuple[torch.Tensor, torch.Tensor]:
    """Real maps of five vehicles at one crossing, in the ego's frame."""
    source = ToySource()
    (sweeps,) = source.sweeps(source.load("toy-1"), [0])
    poses = torch.zeros(N, 3)
    for i, sweep in enumerate(sweeps[:N]):
        poses[i, :2] = torch.from_numpy(sweep.origin[:2] - sweeps[0].origin[:2])
    return detector.warp(detector.encode(sweeps[:N]), poses)[None], detector.coverage(poses)[None]


def test_encode_one_sweep(benchmark: Benchmark, detector: Detector) -> None:
    grid = torch.rand(1, BEV.slices, BEV.size, BEV.size, generator=torch.Generator().manual_seed(0)) < 0.02
    with torch.no_grad():
        benchmark(detector.encode_grids, grid)


def test_warp_five_maps(benchmark: Benchmark, detector: Detector) -> None:
    poses = torch.tensor([[0.0, 0, 0], [3.3, 9.1, 0], [-8.7, 0, 0], [20.2, 1, 0], [0, -17.9, 0]])
    maps = torch.rand(N, detector.channels, detector.size, detector.size, generator=torch.Generator().manual_seed(0))
    benchmark(detector.warp, maps, poses)


@pytest.mark.parametrize("views", [1, 3, 48])
def test_views(
    benchmark: Benchmark, detector: Detector, situation: tuple[torch.Tensor, torch.Tensor], views: int
) -> None:
    """Fusion, decoding and boxes of so many views; at most 4 ms a view is promised."""
    world = torch.zeros(views, dtype=torch.long)
    groups = torch.rand(views, N, generator=torch.Generator().manual_seed(1)) < 0.6
    groups[:, 0] = True

    @torch.no_grad()
    def verify() -> None:
        detector.detect(detector.perceive(*situation, world, groups))

    benchmark(verify)
    if benchmark.stats is not None:  # type: ignore[attr-defined]
        benchmark.extra_info["ms_a_view"] = 1e3 * benchmark.stats.stats.median / views  # type: ignore[attr-defined]


def test_rasterise_five_sweeps(benchmark: Benchmark) -> None:
    source = ToySource()
    (sweeps,) = source.sweeps(source.load("toy-0"), [0])
    benchmark(rasterise, sweeps[:N])
