"""How fast boxes are suppressed, compared and scored on one thread: `pytest benchmarks/test_boxes.py`.

A view is what a decoder gives of a busy street: 30 cars, most of them guessed at twice, 60 boxes before suppression.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from cp_env.geometry.boxes import nms_batch, rotated_iou
from cp_env.metrics.average_precision import ApMeter, resampled_ap
from cp_env.metrics.similarity import agreement, jaccard_many, view_similarity
from cp_env.types import Detections, View

Benchmark = Callable[..., Any]
VIEWS = pytest.mark.parametrize("n_views", [1, 3, 16, 48])
NMS_IOU = 0.15


def street(seed: int) -> np.ndarray:
    """30 cars, none on another: a lane of five every ten metres, [30, 5]."""
    rng = np.random.default_rng(seed)
    place = np.stack(np.meshgrid(np.linspace(-28, 28, 6), np.linspace(-28, 28, 5)), axis=-1).reshape(-1, 2)
    size = rng.normal([4.5, 1.9], [0.3, 0.1], size=(30, 2))
    return np.concatenate([place + rng.normal(0, 1, (30, 2)), size, rng.uniform(0, 3, (30, 1))], axis=1)


def guesses(seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    boxes = np.repeat(street(seed), 2, axis=0)
    return (boxes + rng.normal(0, [0.4, 0.4, 0.2, 0.1, 0.1], boxes.shape)).astype(np.float32), rng.random(60)


def view(seed: int, frame: int) -> View:
    rng = np.random.default_rng(frame)
    boxes = street(seed) + rng.normal(0, 0.1, (30, 5)) - [2.0 * frame, 0, 0, 0, 0]
    seen = Detections(boxes, np.linspace(1, 0.5, 30))
    return View(frozenset({0}), frame, np.array([2.0 * frame, 0.0]), seen, seen, rng.random((64, 64)) ** 8)


@VIEWS
def test_suppress(benchmark: Benchmark, n_views: int) -> None:
    views = [guesses(seed) for seed in range(n_views)]
    boxes, scores = np.concatenate([b for b, _ in views]), np.concatenate([s for _, s in views])
    kept = benchmark(nms_batch, boxes, scores, np.repeat(np.arange(n_views), 60), NMS_IOU)
    assert 28 * n_views <= len(kept) <= 36 * n_views


@VIEWS
def test_jaccard(benchmark: Benchmark, n_views: int) -> None:
    a, b = ([view(seed, frame).seen.boxes for seed in range(n_views)] for frame in (0, 0))
    b = [boxes + np.random.default_rng(9).normal(0, 0.1, boxes.shape) for boxes in b]
    assert benchmark(jaccard_many, a, b).min() > 0.8


def test_similarity_of_two_views(benchmark: Benchmark) -> None:
    assert benchmark(view_similarity, view(0, 0), view(0, 1)) > 0.8


def test_agreement_of_two_views(benchmark: Benchmark) -> None:
    assert 0 < benchmark(agreement, view(0, 0), view(0, 1)) <= 0.5


@pytest.mark.parametrize("n_pairs", [1, 100, 1000])
def test_overlap_of_pairs(benchmark: Benchmark, n_pairs: int) -> None:
    rng = np.random.default_rng(0)
    a, b = rng.uniform([-3, -3, 3, 1, 0], [3, 3, 6, 2, 7], size=(2, n_pairs, 5))
    benchmark(rotated_iou, a, b)


def test_count_a_frame(benchmark: Benchmark) -> None:
    boxes, scores = guesses(0)
    found, truth = Detections(boxes, scores), street(0)
    benchmark(lambda: ApMeter().add(found, truth))


def test_resample_20_scenes_of_100_frames(benchmark: Benchmark) -> None:
    frame = ApMeter()
    boxes, scores = guesses(0)
    frame.add(Detections(boxes, scores), street(0))
    scene = frame
    for _ in range(99):
        scene = scene.merge(frame)
    statistic = resampled_ap([scene] * 20, 0.5)
    rng = np.random.default_rng(0)
    assert 0 < benchmark(lambda: statistic(rng.integers(20, size=20))) <= 1
