"""The scene bank: same numbers with and without the cache, and clear words for a broken one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from cp_env.detector import Detector, load_detector
from cp_env.detector.model.fusion import FUSIONS
from cp_env.detector.protocol import SharesMaps
from cp_env.world.scene_cache import SceneBank
from examples.bring_your_own_detector import Toy
from tests.helpers.toy_scenes import ToySource


@pytest.fixture
def fresh(detector: Detector, tmp_path: Path) -> SceneBank:
    return SceneBank(ToySource(n_frames=3), detector, tmp_path, progress=False)


def test_features_are_what_the_encoder_says(fresh: SceneBank) -> None:
    episode = fresh.episode("toy-0", 3, True)
    sweeps = fresh.source.sweeps(episode.scene, [1])[0]
    direct = fresh.detector.encode([sweeps[0], sweeps[1], sweeps[2], sweeps[-1]])
    np.testing.assert_allclose(episode.maps("features", 1), direct, atol=2e-3, rtol=2e-3)
    warped = fresh.detector.warp(direct, episode.ego_T_sender[1])
    np.testing.assert_allclose(episode.maps("received", 1), warped, atol=2e-3, rtol=2e-3)


def test_the_cache_gives_back_the_same_bits(fresh: SceneBank, detector: Detector) -> None:
    first = fresh.episode("toy-0", 4, False)
    again = SceneBank(fresh.source, detector, fresh.root.parent, progress=False).episode("toy-0", 4, False)
    for t in range(3):
        assert torch.equal(first.maps("received", t), again.maps("received", t))
    assert torch.equal(first.clean.logits, again.clean.logits)


def test_more_vehicles_reuse_what_is_there(fresh: SceneBank) -> None:
    fresh.episode("toy-0", 2, False)
    stamps = {path: path.stat().st_mtime_ns for path in fresh.root.rglob("*.npy")}
    larger = fresh.episode("toy-0", 4, True)
    assert all(path.stat().st_mtime_ns == stamp for path, stamp in stamps.items())
    alone = SceneBank(fresh.source, fresh.detector, fresh.root / "elsewhere", progress=False).episode("toy-0", 4, True)
    np.testing.assert_allclose(larger.maps("received", 2), alone.maps("received", 2), atol=2e-3)


def test_fusions_of_one_encoder_share_their_maps(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = ToySource(n_frames=2)
    first = SceneBank(source, load_detector("mean"), tmp_path, progress=False).episode("toy-0", 3, False)
    monkeypatch.setattr(Detector, "encode", lambda *_: pytest.fail("encoded again"))
    for name in sorted(FUSIONS.keys() - {"mean"}):
        episode = SceneBank(source, load_detector(name), tmp_path, progress=False).episode("toy-0", 3, False)
        assert torch.equal(episode.maps("received", 1), first.maps("received", 1))
        assert not torch.equal(episode.clean.logits, first.clean.logits), "what the ego sees is each fusion's own"
    assert len(list(tmp_path.iterdir())) == 1


def test_others_maps_are_never_shared(detector: Detector, tmp_path: Path) -> None:
    """Another encoder, another class, and a detector that says nothing of its maps have folders of their own."""

    class Louder(Detector):
        """Encodes otherwise with the same weights."""

    louder, mine, twice = Louder().freeze(), Toy().freeze(), Toy().freeze()
    louder.load_state_dict(detector.state_dict())
    twice.scale = torch.nn.Parameter(torch.tensor(2.0), requires_grad=False)
    assert not isinstance(mine, SharesMaps)
    source = ToySource(n_frames=2)
    banks = [SceneBank(source, one, tmp_path) for one in (detector, louder, load_detector("mean"), mine, twice)]
    assert len({bank.root for bank in banks}) == len(banks)


def test_a_broken_file_is_named(fresh: SceneBank) -> None:
    fresh.episode("toy-0", 2, False)
    victim = next(fresh.root.rglob("received-1.npy"))
    victim.write_bytes(victim.read_bytes()[:1000])
    with pytest.raises(ValueError, match=r"broken cache file .*received-1\.npy.*delete it"):
        SceneBank(fresh.source, fresh.detector, fresh.root.parent, progress=False).episode("toy-0", 2, False)


def test_more_vehicles_than_the_scene_holds(fresh: SceneBank) -> None:
    with pytest.raises(ValueError, match=r"n_vehicles = 7, but scene 'toy-0' holds only 5"):
        fresh.episode("toy-0", 7, False)


def test_no_road_side_unit_where_one_is_wanted(detector: Detector, tmp_path: Path) -> None:
    bank = SceneBank(ToySource(n_frames=2, rsu=False), detector, tmp_path, progress=False)
    with pytest.raises(ValueError, match="no road-side unit"):
        bank.episode("toy-0", 3, True)
