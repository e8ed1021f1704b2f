"""Every source keeps the laws of `check_scenes`; for every law there is a source that breaks it, and is named."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cp_env.lidar.returns import count_returns, standing
from cp_env.scenes import Town
from cp_env.scenes.clip import Clip
from cp_env.scenes.opv2v.source import OPV2V
from cp_env.scenes.opv2v.writer import write
from cp_env.testing import check_scenes
from cp_env.testing.scenes import LAWS, MISREADINGS, LawBroken
from cp_env.types import Scene, SceneSource, Sweep
from tests.helpers.toy_scenes import ToySource

FRAMES = 3


@cache
def crossing() -> tuple[Scene, list[list[Sweep]]]:
    source = ToySource(n_frames=FRAMES, n_connected=2)
    scene = source.load("toy-1")
    return scene, source.sweeps(scene, range(FRAMES))


class Recorded:
    """One crossing with its sweeps recorded: a source that keeps every law, for mutants to break one each."""

    name, digest = "recorded", "recorded-1"

    def names(self) -> tuple[str, ...]:
        return ("toy-1",)

    def load(self, name: str) -> Scene:
        if name not in self.names():
            raise ValueError(f"unknown scene {name!r}")
        return copy.copy(self.scene(crossing()[0]))

    def sweeps(self, scene: Scene, frames: Sequence[int]) -> list[list[Sweep]]:
        return [[self.sweep(crossing()[0], t, a, s) for a, s in enumerate(crossing()[1][t])] for t in frames]

    def scene(self, scene: Scene) -> Scene:
        return scene

    def sweep(self, scene: Scene, t: int, agent: int, sweep: Sweep) -> Sweep:
        return sweep


def bent(value: Any, **fields: Any) -> Any:
    """A copy with other fields, unchecked."""
    value = copy.copy(value)
    for key, field in fields.items():
        object.__setattr__(value, key, field)
    return value


def poses(change: Callable[[np.ndarray], None]) -> Callable[[Any, Scene], Scene]:
    """Scenes with `change` done to their poses."""

    def scene(self: Any, scene: Scene) -> Scene:
        pose = scene.pose.copy()
        change(pose)
        return bent(scene, pose=pose)

    return scene


def points(change: Callable[[np.ndarray], np.ndarray]) -> Callable[..., Sweep]:
    """Sweeps with `change` done to their points."""
    return lambda self, scene, t, agent, sweep: replace(sweep, points=change(sweep.points))


def half_gone(pose: np.ndarray) -> None:
    pose[0, 5, 2] = np.nan


def ego_gone(pose: np.ndarray) -> None:
    pose[1, 0] = np.nan


def swapped(pose: np.ndarray) -> None:
    pose[2, [2, 12]] = pose[2, [12, 2]]


def mirrored(pose: np.ndarray) -> None:
    pose[..., 2] *= -1


def in_degrees(pose: np.ndarray) -> None:
    pose[..., 2] = np.rad2deg(pose[..., 2])


class Counting(Recorded):
    """Gives another answer each time."""

    def __init__(self) -> None:
        self.calls = 0


class Forgetful(Counting):
    def names(self) -> tuple[str, ...]:
        self.calls += 1
        return ("toy-1",) if self.calls < 2 else ("toy-1", "toy-2")


class Noisy(Recorded):
    def sweeps(self, scene: Scene, frames: Sequence[int]) -> list[list[Sweep]]:
        jitter = np.random.default_rng(len(frames)).normal(0, 0.01, 3).astype(np.float32)
        return [
            [replace(s, points=s.points + jitter) for s in recording] for recording in super().sweeps(scene, frames)
        ]


class Drifting(Counting):
    def scene(self, scene: Scene) -> Scene:
        self.calls += 1
        return replace(scene, size=scene.size + 1e-9 * self.calls)


class Locked(Recorded):
    def __init__(self) -> None:
        self.closure = lambda: None


class Reseeded(Recorded):
    """Its digest does not survive the way to another process."""

    def __init__(self) -> None:
        self.digest = "first"

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.digest = "second"


class Cyclic(Recorded):
    def sweeps(self, scene: Scene, frames: Sequence[int]) -> list[list[Sweep]]:
        return super().sweeps(scene, [t % FRAMES for t in frames])


def shy(self: Any, scene: Scene, t: int, agent: int, sweep: Sweep) -> Sweep:
    """From the sensor's own place, half a metre behind the middle."""
    if agent == 2:
        return sweep
    back = 0.5 * np.array([np.cos(scene.pose[t, agent, 2]), np.sin(scene.pose[t, agent, 2]), 0])
    return Sweep(sweep.points + back.astype(np.float32), sweep.origin - back, sweep.hits)


def turned(self: Any, scene: Scene, t: int, agent: int, sweep: Sweep) -> Sweep:
    """Along the vehicle's axes instead of the world's."""
    yaw = scene.pose[t, agent, 2] if agent < 2 else 0.4
    turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]], dtype=np.float32)
    return replace(sweep, points=sweep.points @ turn, hits=None)


class SelfAware(Recorded):
    def sweep(self, scene: Scene, t: int, agent: int, sweep: Sweep) -> Sweep:
        return replace(sweep, points=np.concatenate([sweep.points, np.array([[0.1, 0.1, 1.0]], dtype=np.float32)]))


def boastful(self: Any, scene: Scene, t: int, agent: int, sweep: Sweep) -> Sweep:
    """One vehicle is said to return more than it does."""
    assert sweep.hits is not None
    hits = sweep.hits.copy()
    hits[hits.argmax()] *= 3
    return replace(sweep, hits=hits)


def across(pose: np.ndarray) -> None:
    """Parked vehicles stand across the street."""
    pose[:, 8:, 2] += np.pi / 2


def axes(turn: list[list[float]]) -> Callable[..., Sweep]:
    """Points whose x and y are read otherwise; the hits are counted anew, as a reader would."""

    def sweep(self: Any, scene: Scene, t: int, agent: int, sweep: Sweep) -> Sweep:
        points = sweep.points @ np.float32([[*turn[0], 0], [*turn[1], 0], [0, 0, 1]]).T
        return replace(sweep, points=points, hits=count_returns(points, standing(scene, t, sweep.origin[:2])))

    return sweep


def unmet(self: Any, scene: Scene, t: int, agent: int, sweep: Sweep) -> Sweep:
    """No vehicle returns anything."""
    solid = sweep.points[:, 2] > 0.25
    place = np.abs(sweep.points[:, :2] + sweep.origin[:2])
    return replace(sweep, points=sweep.points[~(solid & (place.max(axis=1) < 32))], hits=None)


def of(base: type[Recorded] = Recorded, **members: Any) -> Callable[[], Any]:
    return type("Mutant", (base,), members)


def without_last(self: Any, scene: Scene, frames: Sequence[int]) -> list[list[Sweep]]:
    return [recording[:-1] for recording in Recorded.sweeps(self, scene, frames)]


def unit_first(self: Any, scene: Scene, frames: Sequence[int]) -> list[list[Sweep]]:
    return [[recording[-1], *recording[:-1]] for recording in Recorded.sweeps(self, scene, frames)]


def with_fields(**fields: Any) -> Callable[[], Any]:
    return of(scene=lambda self, scene: bent(scene, **fields))


MUTANTS: list[tuple[str, str, Callable[[], Any]]] = [
    ("it_is_a_source", "lacks a method", lambda: object()),
    ("it_is_a_source", "a digest that is a path", of(digest="../elsewhere")),
    ("names_are_fixed", "no scenes", of(names=lambda self: ())),
    ("names_are_fixed", "one name twice", of(names=lambda self: ("toy-1", "toy-1"))),
    ("names_are_fixed", "other names later", Forgetful),
    ("names_are_fixed", "a scene called otherwise", with_fields(name="toy-9")),
    ("names_are_fixed", "any name is taken", of(load=lambda self, name: crossing()[0])),
    ("arrays_have_their_shapes", "sizes in the plane", with_fields(size=np.ones((14, 2)))),
    ("arrays_have_their_shapes", "connected as a mask", with_fields(connected=np.array([True, True]))),
    ("arrays_have_their_shapes", "nobody is connected", with_fields(connected=np.zeros(0, dtype=int))),
    ("arrays_have_their_shapes", "obstacles without height", with_fields(obstacles=np.ones((2, 5)))),
    ("numbers_make_sense", "a heading is unknown", of(scene=poses(half_gone))),
    ("numbers_make_sense", "flat vehicles", with_fields(size=np.zeros((14, 3)))),
    ("numbers_make_sense", "no time passes", with_fields(dt=0.0)),
    ("connected_vehicles_are_there", "the ego comes and goes", of(scene=poses(ego_gone))),
    ("connected_vehicles_are_there", "one radio twice", with_fields(connected=np.array([0, 0]))),
    ("connected_vehicles_are_there", "a radio of nobody", with_fields(connected=np.array([0, 14]))),
    ("rows_keep_their_vehicle", "rows change owners", of(scene=poses(swapped))),
    ("vehicles_drive_where_they_look", "left-handed headings", of(scene=poses(mirrored))),
    ("vehicles_drive_where_they_look", "degrees", of(scene=poses(in_degrees))),
    ("sweeps_have_their_shapes", "the unit is silent", of(sweeps=without_last)),
    (
        "sweeps_have_their_shapes",
        "points with intensity",
        of(sweep=lambda s, c, t, a, w: bent(w, points=np.ones((5, 4)))),
    ),
    ("sweeps_have_their_shapes", "an empty sweep", of(sweep=points(lambda p: p[:0]))),
    ("sweeps_have_their_shapes", "hits of some", of(sweep=lambda s, c, t, a, w: replace(w, hits=w.hits[:3]))),
    ("sweeps_are_finite", "misses as NaN", of(sweep=points(lambda p: np.where(p > 20, np.float32(np.nan), p)))),
    ("sweeps_begin_at_their_agent", "from the sensor's place", of(sweep=shy)),
    ("sweeps_begin_at_their_agent", "the unit first", of(sweeps=unit_first)),
    ("the_road_is_at_zero", "z from the sensor", of(sweep=points(lambda p: p - np.float32([0, 0, 1.7])))),
    ("the_road_is_at_zero", "the road left out", of(sweep=points(lambda p: p[p[:, 2] > 0.6]))),
    ("returns_lie_in_their_box", "the vehicle's axes", of(sweep=turned)),
    ("returns_lie_in_their_box", "x mirrored", of(sweep=axes([[-1, 0], [0, 1]]))),
    ("returns_lie_in_their_box", "y mirrored", of(sweep=axes([[1, 0], [0, -1]]))),
    ("returns_lie_in_their_box", "x and y swapped", of(sweep=axes([[0, 1], [1, 0]]))),
    ("returns_lie_in_their_box", "a quarter turn", of(sweep=axes([[0, -1], [1, 0]]))),
    ("returns_lie_in_their_box", "shifted", of(sweep=points(lambda p: p + np.float32([1.0, 0, 0])))),
    ("returns_lie_in_their_box", "headings a quarter on", of(scene=poses(across))),
    ("boxes_hold_their_vehicles", "no returns from vehicles", of(sweep=unmet)),
    ("hits_lie_in_their_box", "too many hits on one vehicle", of(sweep=boastful)),
    (
        "returns_lie_in_their_box",
        "hits in another order",
        of(sweep=lambda s, c, t, a, w: replace(w, hits=w.hits[::-1].copy())),
    ),
    ("carriers_do_not_see_themselves", "its own roof", SelfAware),
    ("frames_do_not_depend_on_their_batch", "noise by batch", Noisy),
    ("loading_again_changes_nothing", "sizes that grow", Drifting),
    ("frames_outside_are_refused", "time is a circle", Cyclic),
    ("pickling_changes_nothing", "a function on board", Locked),
    ("pickling_changes_nothing", "another digest there", Reseeded),
]


@pytest.mark.parametrize(("law", "how", "mutant"), MUTANTS, ids=[f"{law}: {how}" for law, how, _ in MUTANTS])
def test_a_source_that_breaks_a_law_is_told(law: str, how: str, mutant: Callable[[], Any]) -> None:
    with pytest.raises(LawBroken) as told:
        check_scenes(mutant(), frames=FRAMES)
    assert told.value.law == law, str(told.value)


def headings(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Any, Scene], Scene]:
    def scene(self: Any, scene: Scene) -> Scene:
        return bent(scene, pose=np.concatenate([scene.pose[..., :2], change(scene.pose[..., 2:])], axis=-1))

    return scene


WRONG: dict[str, dict[str, Any]] = {
    "x mirrored": {"sweep": axes([[-1, 0], [0, 1]])},
    "y mirrored": {"sweep": axes([[1, 0], [0, -1]])},
    "x and y swapped": {"sweep": axes([[0, 1], [1, 0]])},
    "turned by 90° to the left": {"sweep": axes([[0, -1], [1, 0]])},
    "turned by 90° to the right": {"sweep": axes([[0, 1], [-1, 0]])},
    "turned by 180°": {"sweep": axes([[-1, 0], [0, -1]])},
    "shifted east": {"sweep": points(lambda p: p + np.float32([1.0, 0, 0]))},
    "shifted north": {"sweep": points(lambda p: p + np.float32([0, 1.0, 0]))},
    "shifted both ways": {"sweep": points(lambda p: p - np.float32([0.8, 0.8, 0]))},
    "headings a quarter on": {"scene": headings(lambda yaw: yaw + np.pi / 2)},
    "headings reversed": {"scene": headings(np.negative)},
    "headings from north": {"scene": headings(lambda yaw: np.pi / 2 - yaw)},
}


@pytest.mark.parametrize("hits", [True, False], ids=["told", "not told"])
@pytest.mark.parametrize("wrong", WRONG)
def test_the_law_of_boxes_alone_finds_every_misreading(wrong: str, hits: bool) -> None:
    """Whether the source counts returns by its boxes, says who returned them, or says nothing."""
    source = of(**WRONG[wrong])()
    if not hits:
        counted = type(source).sweep
        source = of(**WRONG[wrong] | {"sweep": lambda *args: replace(counted(*args), hits=None)})()
    others = [law.__name__ for law in LAWS if law.__name__ != "returns_lie_in_their_box"]
    with pytest.raises(LawBroken, match=r"only \d+ of \d+ have") as told:
        check_scenes(source, frames=FRAMES, skip=others)
    turns = wrong in MISREADINGS
    assert ("would with" in str(told.value)) == turns, "a turn of the axes is named"


def test_a_misreading_is_named_by_what_would_mend_it() -> None:
    with pytest.raises(LawBroken, match=r"would with x mirrored\n  the law: Of the vehicles within 30 m"):
        check_scenes(of(sweep=axes([[-1, 0], [0, 1]]))(), frames=1)
    with pytest.raises(LawBroken, match="would with turned by 90° to the left"):
        check_scenes(of(sweep=axes([[0, 1], [-1, 0]]))(), frames=1)


@pytest.mark.parametrize("split", ["train", "calibration", "test"])
def test_the_returns_of_the_town_lie_in_their_boxes(split: str) -> None:
    others = [law.__name__ for law in LAWS if law.__name__ != "returns_lie_in_their_box"]
    assert check_scenes(Clip(Town(split), vehicles=3), scenes=6, frames=2, skip=others)


def test_every_law_has_a_mutant() -> None:
    assert {law for law, _, _ in MUTANTS} == {law.__name__ for law in LAWS}


def miniature(source: SceneSource, folder: Path) -> OPV2V:
    write(source, source.names(), folder)
    return OPV2V(folder)


def test_every_source_keeps_every_law(tmp_path: Path) -> None:
    toy = ToySource(n_frames=FRAMES, n_connected=2)
    every = tuple(law.__name__ for law in LAWS)
    for source in (Recorded(), toy, Clip(Town("test"), vehicles=2), miniature(toy, tmp_path)):
        assert check_scenes(source, frames=2) == every, source.name


def test_laws_can_be_left_out_by_name() -> None:
    source = SelfAware()
    assert "carriers_do_not_see_themselves" not in check_scenes(source, skip=["carriers_do_not_see_themselves"])
    with pytest.raises(ValueError, match="no laws called"):
        check_scenes(source, skip=["gravity"])
    with pytest.raises(ValueError, match="at least 1"):
        check_scenes(source, frames=0)
    with pytest.raises(ValueError, match="unknown scenes 'village'"):
        check_scenes("village")
