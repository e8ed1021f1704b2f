"""The clean figures of a detector."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cp_env.detector import Detector
from cp_env.detector.model.weights import FOLDER, about, read_detector, save_detector
from cp_env.detector.training import evaluate
from cp_env.detector.training.evaluate import (
    GRID,
    Args,
    Report,
    Seen,
    calibrate,
    jaccard,
    perceive_scenes,
    report,
    table,
)
from cp_env.types import Detections
from tests.helpers.toy_scenes import ToySource

CAR = np.array([[5.0, 8.0, 4.5, 1.8, 0.2]])
FAR = np.array([[-20.0, 8.0, 4.5, 1.8, 0.2]])


def seen(origin: float, boxes: np.ndarray, scores: list[float], scene: str = "a") -> Seen:
    """A frame in which the ego alone sees nothing, and two see `boxes`; the truth is CAR, 5 m ahead of x = 0."""
    nothing = Detections(np.zeros((0, 5)), np.zeros(0))
    truth = CAR - [origin, 0, 0, 0, 0]
    found = Detections(boxes - [origin, 0, 0, 0, 0], np.array(scores))
    return Seen(scene, np.array([origin, 0.0]), [nothing, found], truth, 1, (0.5, 2.0))


def test_figures_by_hand() -> None:
    both = np.concatenate([CAR, FAR])
    frames = [seen(0.0, both, [0.9, 0.3]), seen(1.0, CAR, [0.8]), seen(0.0, FAR, [0.6], scene="b")]
    result = report(frames, threshold=0.5)
    assert result.ap50[0] == 0 and result.ap50[1] == pytest.approx(2 / 3)  # two of three found, before any false one
    assert result.jaccard == 1.0  # at 0.5 the ghost is not seen, and the car does not move; scene b has no pair
    assert jaccard(frames, 0.2) == 0.5
    assert (result.precision, result.recall) == (pytest.approx(2 / 3), pytest.approx(2 / 3))
    assert (result.visible, result.mean, result.high) == (1.0, 0.5, 2.0)


def test_calibration_prefers_boxes_that_are_right_and_stay() -> None:
    both = np.concatenate([CAR, FAR])
    frames = [seen(0.5 * t, both if t % 2 else CAR, [0.66, 0.31][: 1 + t % 2]) for t in range(6)]
    threshold = calibrate(frames)  # the flickering ghost has 0.31, the car 0.66
    assert threshold in GRID and 0.31 < threshold <= 0.66


def test_every_frame_is_perceived() -> None:
    frames = list(perceive_scenes(Detector().freeze(), ToySource(n_frames=3), Args(n_vehicles=3, frames=7)))
    assert [frame.scene for frame in frames] == ["toy-0"] * 3 + ["toy-1"] * 3
    assert all(len(frame.detections) == 3 and 5 < len(frame.truth) < 14 for frame in frames)
    assert all(0 < frame.n_visible <= len(frame.truth) for frame in frames)
    with pytest.raises(ValueError, match="toy-0 holds 5 connected vehicles, not 6"):
        next(perceive_scenes(Detector(), ToySource(n_frames=1), Args(n_vehicles=6)))


def test_the_road_side_unit_is_fused_last() -> None:
    args = Args(n_vehicles=2, rsu=True, frames=1, limit=1)
    with_unit = list(perceive_scenes(Detector().freeze(), ToySource(n_frames=1), args))
    assert len(with_unit[0].detections) == 3
    alone = next(perceive_scenes(Detector().freeze(), ToySource(n_frames=1), replace(args, rsu=False)))
    assert with_unit[0].n_visible > alone.n_visible, "it sees what the two do not"
    rows = table(report(with_unit, threshold=0.5), rsu=True).columns[0]
    assert list(rows.cells) == ["1 (ego)", "2", "2 and the RSU"]
    with pytest.raises(ValueError, match="toy-0 has no road-side unit; leave --rsu out"):
        next(perceive_scenes(Detector(), ToySource(n_frames=1, rsu=False), args))


def test_command_calibrates_and_writes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "mean.safetensors"
    trained = read_detector(FOLDER / "mean.safetensors")
    trained.threshold = 0.99
    save_detector(trained, path, steps=3)
    monkeypatch.setattr(evaluate, "open_source", lambda _: ToySource(n_frames=2))
    args = Args(scenes="toy", weights=path, calibrate=True, json=tmp_path / "figures.json", n_vehicles=2)
    evaluate.main(args)
    assert read_detector(path).threshold in GRID
    assert about(path) == {"steps": 3, "calibrated": "toy"}
    figures = json.loads((tmp_path / "figures.json").read_text())
    assert figures.keys() == Report.__dataclass_fields__.keys() and figures["n_frames"] == 4
    with pytest.raises(ValueError, match="name the file with --weights"):
        evaluate.main(replace(args, weights=None))
    with pytest.raises(ValueError, match="give one of the two"):
        evaluate.main(replace(args, detector="mine:Toy"))


def test_a_threshold_at_which_nothing_is_found_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Random weights find nothing that is there: the file is left as it was."""
    path = tmp_path / "mean.safetensors"
    save_detector(Detector(threshold=0.99), path)
    before = path.read_bytes()
    monkeypatch.setattr(evaluate, "open_source", lambda _: ToySource(n_frames=2))
    with pytest.raises(ValueError, match=r"at no threshold from 0\.1 to 0\.7 .*nothing was written"):
        evaluate.main(Args(scenes="toy", weights=path, calibrate=True, n_vehicles=2))
    assert path.read_bytes() == before
    with pytest.raises(ValueError, match="at no threshold"):
        calibrate([seen(0.0, FAR, [0.9]), seen(0.0, FAR, [0.9])])
    with pytest.raises(ValueError, match="at no threshold"):
        calibrate([seen(0.0, CAR, [0.9])])


def test_a_detector_of_your_own_is_measured(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """By its name, as everywhere; the example's toy, which needs no training."""
    monkeypatch.setattr(evaluate, "open_source", lambda _: ToySource(n_frames=2))
    out = tmp_path / "figures.json"
    evaluate.main(Args(scenes="toy", detector="examples.bring_your_own_detector:Toy", n_vehicles=2, json=out))
    figures = json.loads(out.read_text())
    assert figures["ap50"][1] > 0 and figures["threshold"] == 0.5
