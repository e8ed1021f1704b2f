"""The program behind Fig. 6: what it plays, reads and draws."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from cp_env.detector import load_detector
from cp_env.world.scene_cache import SceneBank
from examples.reproduce import jaccard_histograms
from tests.helpers.toy_scenes import ToySource


@pytest.fixture(scope="module")
def bank(tmp_path_factory: pytest.TempPathFactory) -> SceneBank:
    """Three frames of a toy crossing."""
    root = tmp_path_factory.mktemp("bank")
    return SceneBank(ToySource(n_frames=3), load_detector("mean"), root=root, progress=False)


def test_fig_6_compares_consecutive_outputs(bank: SceneBank) -> None:
    args = jaccard_histograms.Args(frames=3, n_vehicles=3, n_attackers=2)
    found = {c: jaccard_histograms.play(bank, "mean", c, "toy-0", args) for c in ("upper bound", "lower bound", "BIM")}
    for values in found.values():
        assert all(len(row) == 2 and all(0 <= value <= 1 for value in row) for row in values.values())
    for bound in ("upper bound", "lower bound"):
        assert found[bound]["to_output"] == found[bound]["to_benign"]
    assert max(found["BIM"]["to_benign"]) < 0.5 < min(found["upper bound"]["to_benign"])
    assert jaccard_histograms.play(bank, "mean", "BIM", "toy-0", args) == found["BIM"]


def test_fig_6_goes_on_where_it_stopped(
    bank: SceneBank, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(jaccard_histograms, "KINDS", {"intersection": "k"})
    monkeypatch.setattr(jaccard_histograms, "open_source", lambda _: bank.source)
    monkeypatch.setattr(jaccard_histograms, "SceneBank", lambda *_, **__: bank)
    args = jaccard_histograms.Args(n_scenes=2, frames=2, fusions=("mean",), out=tmp_path)
    seen: list[str] = []

    def quick(_: Any, fusion: str, condition: str, name: str, __: Any) -> dict[str, list[float]]:
        if len(seen) == 7:
            raise KeyboardInterrupt
        seen.append(f"{fusion} {condition} {name}")
        return {"to_output": [0.5], "to_benign": [0.25]}

    monkeypatch.setattr(jaccard_histograms, "play", quick)
    with pytest.raises(KeyboardInterrupt):
        jaccard_histograms.main(args)
    seen.clear()
    jaccard_histograms.main(args)
    assert len(seen) == 3  # of ten
    data = json.loads((tmp_path / "jaccard.json").read_text())
    assert [len(row["scenes"]) for row in data["rows"]] == [2] * 5
    assert (tmp_path / "jaccard.png").stat().st_size > 10_000 and "0.50" in capsys.readouterr().out
