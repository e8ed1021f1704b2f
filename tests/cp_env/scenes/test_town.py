"""Laws that hold in every scene that ships, and what bad input to the reader gets."""

from __future__ import annotations

import json
import shutil
from collections import Counter
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import shapely

from cp_env.geometry.planar import corners
from cp_env.scenes import FAMILIES, KINDS, SPLITS, Junction, Town, open_source
from cp_env.scenes.formats.recording import wrap
from cp_env.scenes.sumo.regimes import Pace, keeps, pace_of
from cp_env.scenes.town import DATA, INDEX
from cp_env.types import Scene, SceneSource

TOWNS = {f"{regime}/{split}": family(split) for regime, family in FAMILIES.items() for split in SPLITS}
SCENES = [(split, name) for split in TOWNS for name in TOWNS[split].names()]
PACES: tuple[Pace, ...] = ("flows", "waits")
every_scene = pytest.mark.parametrize(("split", "name"), SCENES, ids=[name for _, name in SCENES])


def footprints(scene: Scene, frame: int) -> np.ndarray:
    """Polygons of the vehicles present in `frame`."""
    here = ~np.isnan(scene.pose[frame, :, 0])
    pose, size = scene.pose[frame, here], scene.size[here]
    return shapely.polygons(corners(np.column_stack([pose[:, :2], size[:, :2], pose[:, 2]])))


@cache
def solids(split: str, name: str) -> shapely.STRtree:
    boxes = TOWNS[split].load(name).obstacles
    return shapely.STRtree(shapely.polygons(corners(boxes[:, [0, 1, 3, 4, 2]])))


@every_scene
def test_a_scene_is_well_formed(split: str, name: str) -> None:
    scene = TOWNS[split].load(name)
    n_vehicles = len(scene.size)
    assert (scene.name, scene.n_frames, scene.dt) == (name, 100, 0.2)
    assert scene.kind in KINDS and (f"-{scene.kind}-" in name or split.startswith("junction/"))
    assert scene.pose.shape == (100, n_vehicles, 3) and scene.size.shape == (n_vehicles, 3)
    assert scene.obstacles.shape[1:] == (6,)
    absent = np.isnan(scene.pose)
    assert (absent.all(axis=2) == absent.any(axis=2)).all(), "a pose is all there or all absent"
    assert not absent.all(axis=(0, 2)).any(), "nobody is absent throughout"
    assert np.isfinite(scene.size).all() and np.isfinite(scene.obstacles).all()
    assert np.nanmax(np.abs(scene.pose[..., 2])) <= np.pi + 1e-6
    assert np.nanmax(np.abs(scene.pose[..., :2])) < 250, "the world is centred on the ego's path"


@every_scene
def test_sizes_are_those_of_road_vehicles(split: str, name: str) -> None:
    length, width, height = TOWNS[split].load(name).size.T
    assert ((length > 3.4) & (length <= 12.01)).all()
    assert ((width > 1.55) & (width <= 2.56)).all()
    assert ((height > 1.35) & (height <= 3.75)).all()
    assert (length > 1.7 * width).all()
    assert len(np.unique(length)) > 15, "individuals differ"


@every_scene
def test_the_connected_stay_together_and_apart(split: str, name: str) -> None:
    scene = TOWNS[split].load(name)
    assert (8 if split.startswith("junction/") else 5) <= scene.n_connected <= 8 and len(
        set(scene.connected.tolist())
    ) == scene.n_connected
    place = scene.pose[:, scene.connected, :2]
    assert np.isfinite(place).all(), "present in every frame"
    gap = np.linalg.norm(place[:, :, None] - place[:, None], axis=3)
    assert gap[:, 0].max() <= 50.0, "in radio range of the ego"
    assert (gap + 1e3 * np.eye(scene.n_connected) > 1.5).all(), "no two in one place"
    mean = gap[:, 0].mean(axis=0)
    assert (np.diff(mean[:5]) >= -3.0).all(), "the first four partners come about nearest first"


@every_scene
def test_the_road_side_unit_stands_free_near_the_ego(split: str, name: str) -> None:
    scene = TOWNS[split].load(name)
    assert scene.rsu is not None and 5.5 <= scene.rsu[2] <= 6.7
    assert len(solids(split, name).query(shapely.Point(scene.rsu[:2]), predicate="dwithin", distance=0.2)) == 0
    assert np.linalg.norm(scene.pose[:, scene.connected[0], :2] - scene.rsu[:2], axis=1).min() < 60


@every_scene
def test_no_two_vehicles_share_ground_and_none_stands_in_a_building(split: str, name: str) -> None:
    scene = TOWNS[split].load(name)
    for frame in range(0, scene.n_frames, 11):
        shapes = footprints(scene, frame)
        a, b = shapely.STRtree(shapes).query(shapes, predicate="intersects")
        shared = shapely.area(shapely.intersection(shapes[a[a < b]], shapes[b[a < b]]))
        assert (shared < 0.05).all(), f"frame {frame}: {shared.max():.2f} m² shared"
        assert len(solids(split, name).query(shapes, predicate="intersects")[0]) == 0, f"frame {frame}"


@every_scene
def test_obstacles_do_not_pile_up(split: str, name: str) -> None:
    tree = solids(split, name)
    a, b = tree.query(tree.geometries, predicate="intersects")
    shared = shapely.area(shapely.intersection(tree.geometries[a[a < b]], tree.geometries[b[a < b]]))
    assert (shared < 0.1).all(), "neighbouring houses touch at a corner at most"
    assert (TOWNS[split].load(name).obstacles[:, 3:] > 0.1).all()


@every_scene
def test_motion_is_smooth(split: str, name: str) -> None:
    pose = TOWNS[split].load(name).pose
    step = np.diff(pose, axis=0)
    distance, turn = np.hypot(step[..., 0], step[..., 1]), np.abs(wrap(step[..., 2]))
    assert np.nanmax(distance) < 2.3, "8.33 m/s is the limit, and a corner adds to it"
    assert np.nanmax(turn) < 0.35, "rad a frame"
    assert np.nanmax(turn - distance / 2.2) < 0.13, "who turns also rolls: corners are no tighter than 2.2 m or so"
    heading = np.stack([np.cos(pose[:-1, :, 2]), np.sin(pose[:-1, :, 2])], axis=-1)
    assert np.nanmin((step[..., :2] * heading).sum(axis=-1)) > -0.2, "nobody reverses"


def test_each_split_has_its_share_of_each_kind() -> None:
    for split, least in (("train", 42), ("calibration", 12), ("test", 21)):
        town = TOWNS[f"town/{split}"]
        kinds = Counter(town.load(name).kind for name in town.names())
        assert len(town.names()) >= least and set(kinds) == set(KINDS) and len(set(kinds.values())) == 1
    assert [len(TOWNS[f"junction/{split}"].names()) for split in SPLITS] == [40, 10, 20]


def test_no_two_scenes_share_a_street() -> None:
    assert len({name for _, name in SCENES}) == len(SCENES)
    owner: dict[tuple[float, ...], str] = {}
    shared: Counter[tuple[str, str]] = Counter()
    for split, name in SCENES:
        boxes = TOWNS[split].load(name).obstacles
        houses = {tuple(np.round(box[3:], 2).tolist()) for box in boxes if box[4] > 3}
        assert len(houses) > 10, f"{name} has few buildings"
        shared.update((name, owner[house]) for house in houses if house in owner)
        owner.update(dict.fromkeys(houses, name))
    assert max(shared.values(), default=0) <= 1, "houses of the same size to the centimetre are rare"


@pytest.mark.parametrize("split", TOWNS)
def test_signals_stop_cars_and_let_them_go(split: str) -> None:
    stopped = 0
    for name in TOWNS[split].names():
        place = TOWNS[split].load(name).pose[..., :2]
        step = np.linalg.norm(np.diff(place, axis=0), axis=2)
        stands = np.stack([(step[t : t + 15] < 0.04).all(axis=0) for t in range(0, 85, 5)])  # three seconds
        drives = np.stack([step[t : t + 15].sum(axis=0) > 6 for t in range(0, 85, 5)])
        later = np.flip(np.maximum.accumulate(np.flip(drives, axis=0), axis=0), axis=0)
        stopped += int((stands[:-3] & later[3:]).any(axis=0).sum())
    assert stopped >= len(TOWNS[split].names())


@pytest.mark.parametrize("split", TOWNS)
def test_traffic_flows_and_a_quarter_of_the_egos_wait(split: str) -> None:
    town = TOWNS[split]
    scenes = [town.load(name) for name in town.names()]
    speed = [np.linalg.norm(np.diff(scene.pose[:, scene.connected, :2], axis=0), axis=2) / 0.2 for scene in scenes]
    assert np.median([np.median(one[:, 0]) for one in speed]) >= 5.0
    flows, waits = (np.array([keeps(pace, one)[0] for one in speed]) for pace in PACES)
    asked = np.array([pace_of(k) == "waits" for k in range(len(scenes))])
    assert flows[~asked].all() and waits[asked].all()
    assert all((one.sum(axis=0) * 0.2 > 9.5).all() for one in speed), "everyone connected drives"


def test_sweeps_are_ordered_by_frame_then_agent() -> None:
    town = TOWNS["town/test"]
    scene = town.load(town.names()[0])
    for frame, sweeps in zip([0, 7], town.sweeps(scene, [0, 7]), strict=True):
        assert len(sweeps) == scene.n_connected + 1
        for row, sweep in zip(scene.connected, sweeps, strict=False):
            assert np.allclose(sweep.origin[:2], scene.pose[frame, row, :2], atol=1e-3)
        assert np.allclose(sweeps[-1].origin, scene.rsu, atol=1e-3)


def test_what_is_loaded_is_shared_and_locked() -> None:
    town = Town("test")
    scene = town.load(town.names()[0])
    assert Town("test").load(town.names()[0]) is scene
    with pytest.raises(ValueError, match="read-only"):
        scene.pose[0] = 0


def test_recordings_are_small() -> None:
    assert sum(path.stat().st_size for path in DATA.rglob("*.*")) < 10e6


def test_names_of_sources() -> None:
    assert isinstance(TOWNS["town/train"], SceneSource)
    assert open_source("town").names() == open_source("town/train").names() == TOWNS["town/train"].names()
    assert open_source("town/test").name == "town/test"
    assert open_source("junction").names() == open_source("junction/train").names() == Junction("train").names()
    assert {name: open_source(name).digest for name in TOWNS} == {name: town.digest for name, town in TOWNS.items()}
    assert open_source(TOWNS["town/train"]) is TOWNS["town/train"]
    assert len({town.digest for town in TOWNS.values()}) == len(TOWNS)
    for wrong in ("city", "town/validation", "", "town/test/0"):
        with pytest.raises(ValueError, match=r"town/train, town/calibration, town/test"):
            open_source(wrong)
    with pytest.raises((ValueError, TypeError), match="SceneSource"):  # TypeError: shapes are checked in tests
        open_source(3)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="train, calibration, test"):
        Town("validation")
    with pytest.raises(ValueError, match="train-urban-00"):
        TOWNS["town/train"].load("test-urban-00")


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """A folder with one scene, the same in every split."""
    name = TOWNS["town/test"].names()[0]
    shutil.copy(DATA / f"{name}.npz", tmp_path)
    (tmp_path / INDEX).write_text(json.dumps({split: [name] for split in SPLITS}))
    return tmp_path


def test_a_folder_of_ones_own_and_its_digest(copy: Path) -> None:
    town = Town("test", copy)
    assert town.load(town.names()[0]).n_frames == 100
    assert town.digest == Town("test", copy).digest != TOWNS["town/test"].digest
    path = copy / f"{town.names()[0]}.npz"
    path.write_bytes(path.read_bytes() + b" ")
    assert Town("test", copy).digest != town.digest


def test_a_broken_or_missing_file_is_named(copy: Path) -> None:
    name = TOWNS["town/test"].names()[0]
    path = copy / f"{name}.npz"
    town = Town("test", copy)
    whole = path.read_bytes()
    for broken in (whole[: len(whole) // 2], b"", b"no recording", whole[:600] + b"\0" * 600 + whole[1200:]):
        path.write_bytes(broken)
        with pytest.raises(ValueError, match=path.name):
            town.load(name)
    path.unlink()
    with pytest.raises(ValueError, match=path.name):
        town.load(name)
    with pytest.raises(ValueError, match=path.name):
        Town("test", copy)
    for text in ("{", "{}", "[]", "[" * 100_000):
        (copy / INDEX).write_text(text)
        with pytest.raises(ValueError, match=INDEX):
            Town("test", copy)
    (copy / INDEX).unlink()
    with pytest.raises(ValueError, match=INDEX):
        Town("test", copy)
