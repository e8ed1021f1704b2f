"""The scene bank: same numbers with and without the cache, and clear words for a broken one."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from cp_env.detector import Detector, load_detector
from cp_env.detector.model.fusion import FUSIONS
from cp_env.detector.protocol import SharesMaps
from cp_env.types import Scene
from cp_env.world.cache_folder import stored_scenes
from cp_env.world.episode import stack_maps
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
        assert torch.equal(first.clean.logits[t], again.clean.logits[t])
        assert torch.equal(first.clean.boxes[t], again.clean.boxes[t])
        assert np.array_equal(first.clean_views[t].score_map, again.clean_views[t].score_map)


def test_more_vehicles_reuse_what_is_there(fresh: SceneBank) -> None:
    fresh.episode("toy-0", 2, False).encode()
    stamps = {path: path.stat().st_mtime_ns for path in fresh.root.rglob("*.maps")}
    larger = fresh.episode("toy-0", 4, True)
    larger.encode()
    assert stamps and all(path.stat().st_mtime_ns == stamp for path, stamp in stamps.items())
    alone = SceneBank(fresh.source, fresh.detector, fresh.root / "elsewhere", progress=False).episode("toy-0", 4, True)
    assert torch.equal(larger.maps("received", 2), alone.maps("received", 2))


def test_what_is_received_is_the_warped_map(fresh: SceneBank) -> None:
    """Grid frames differ by whole cells: nothing is lost by storing maps before the warp. Batches change no bit."""
    episode = fresh.episode("toy-1", 4, True)
    for t in range(3):
        features, pose = episode.maps("features", t), episode.ego_T_sender[t]
        assert torch.equal(features, features.half().float())
        assert torch.equal(episode.maps("received", t), fresh.detector.warp(features, pose))
        assert torch.equal(episode.maps("received", t)[0], features[0])
    places = [(episode, t) for t in (2, 0, 1)]
    for name in ("features", "received"):
        stacked = stack_maps(places, name)
        assert all(torch.equal(row, e.maps(name, t)) for row, (e, t) in zip(stacked, places, strict=True))
    with pytest.raises(ValueError, match=r'maps are "features" or "received", not \'sent\''):
        stack_maps(places, "sent")


def test_what_is_handed_out_is_nobody_elses(fresh: SceneBank) -> None:
    episode = fresh.episode("toy-0", 3, False)
    for name in ("features", "received"):
        before = episode.maps(name, 1).clone()
        episode.maps(name, 1).fill_(7.0)
        assert torch.equal(episode.maps(name, 1), before)


def test_only_frames_that_are_played_are_encoded(detector: Detector, tmp_path: Path) -> None:
    """An episode is made without any; a frame brings its block of five."""
    bank = SceneBank(ToySource(n_frames=12), detector, tmp_path, progress=False)
    episode = bank.episode("toy-0", 2, False)
    assert not bank.root.exists()
    view = episode.clean_views[6]
    assert {path.name for path in bank.root.rglob("*.maps")} == {"map-0-5.maps", "map-1-5.maps"}
    assert view.frame == 6 and view.group == {0, 1} and episode.clean_views[6] is view


def test_clean_output_is_what_the_detector_perceives(fresh: SceneBank) -> None:
    """Whoever asks first, in inference mode or not, gets ordinary tensors with the same numbers."""
    episode = fresh.episode("toy-0", 3, False)
    with torch.inference_mode():
        inside = episode.clean.logits[1]
    assert not inside.is_inference() and not episode.clean.boxes[1].is_inference()
    received, coverage = episode.maps("received", 1)[None], episode.coverage[1:2]
    dense = fresh.detector.perceive(received, coverage, torch.tensor([0]), torch.ones(1, 3, dtype=torch.bool))
    assert torch.equal(inside, dense.logits[0].half()) and torch.equal(episode.clean.boxes[1], dense.boxes[0].half())
    assert np.array_equal(episode.clean_views[1].score_map, dense.scores[0])


def test_fusions_of_one_encoder_share_their_maps(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = ToySource(n_frames=2)
    first = SceneBank(source, load_detector("mean"), tmp_path, progress=False).episode("toy-0", 3, False)
    first.encode()
    monkeypatch.setattr(Detector, "encode", lambda *_: pytest.fail("encoded again"))
    for name in sorted(FUSIONS.keys() - {"mean"}):
        episode = SceneBank(source, load_detector(name), tmp_path, progress=False).episode("toy-0", 3, False)
        assert torch.equal(episode.maps("received", 1), first.maps("received", 1))
        assert not torch.equal(episode.clean.logits[1], first.clean.logits[1]), "what the ego sees is each fusion's own"
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


def test_another_kind_of_device_has_maps_of_its_own(detector: Detector, tmp_path: Path) -> None:
    """Its last bits may differ, and a run on the CPU must not depend on what was played before it."""

    class Movable(Toy):
        device = torch.device("cpu")

    def root(device: str) -> Path:
        Movable.device = torch.device(device)
        return SceneBank(ToySource(n_frames=2), Movable().freeze(), tmp_path).root

    assert root("cpu") == root("cpu") != root("meta")


def test_a_scene_that_is_used_is_the_last_that_a_bound_deletes(fresh: SceneBank) -> None:
    for name in ("toy-0", "toy-1"):
        fresh.episode(name, 2, False).encode()
    for place in fresh.root.iterdir():
        os.utime(place, (1.0, 1.0))
    again = SceneBank(fresh.source, fresh.detector, fresh.root.parent, progress=False)
    again.episode("toy-0", 2, False)
    assert [scene.name for scene in stored_scenes(fresh.root.parent)] == ["toy-1", "toy-0"]


def test_more_vehicles_than_the_scene_holds(fresh: SceneBank) -> None:
    with pytest.raises(ValueError, match=r"n_vehicles = 7, but scene 'toy-0' holds only 5"):
        fresh.episode("toy-0", 7, False)


def test_no_road_side_unit_where_one_is_wanted(detector: Detector, tmp_path: Path) -> None:
    bank = SceneBank(ToySource(n_frames=2, rsu=False), detector, tmp_path, progress=False)
    with pytest.raises(ValueError, match="no road-side unit"):
        bank.episode("toy-0", 3, True)


class Uneven(ToySource):
    """Its first scene has two connected vehicles, the others five."""

    def load(self, name: str) -> Scene:
        scene = super().load(name)
        return replace(scene, connected=scene.connected[:2]) if name == self.names()[0] else scene


def test_a_check_refuses_only_what_no_scene_holds(detector: Detector, tmp_path: Path) -> None:
    bank = SceneBank(Uneven(n_frames=2), detector, tmp_path, progress=False)
    for n_vehicles in (2, 5):
        bank.check(n_vehicles, rsu=False)
    with pytest.raises(ValueError, match=r"n_vehicles = 6, but scene 'toy-0' holds only 2"):
        bank.check(6, rsu=False)
