"""The laws every scene source keeps, ours and yours.

    from cp_env.testing import check_scenes
    check_scenes(MySource("/data/mine"))

Each law is a small function whose docstring states it. They are checked on a few scenes and a few frames of each.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Collection, Iterator
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from cp_env.geometry.planar import grid_origin
from cp_env.scenes import open_source
from cp_env.scenes.preview.box_fit import fit, share_inside
from cp_env.testing.rollout import Violation, require
from cp_env.types import Scene, SceneSource, Sweep

FASTEST = 60.0  # m/s
ROAD = 0.5  # m: so far from z = 0 is what a sensor meets near it still road
NEAR = 15.0  # m
CLOSE = 0.3  # m: how far a return may lie outside the box it is said to come from
ANCHOR = 0.01  # m
SHARE = 0.85  # of the vehicles met have most of their returns in their box
MISREADINGS = {
    "x mirrored": [[-1, 0], [0, 1]],
    "y mirrored": [[1, 0], [0, -1]],
    "x and y swapped": [[0, 1], [1, 0]],
    "turned by 90° to the left": [[0, -1], [1, 0]],
    "turned by 90° to the right": [[0, 1], [-1, 0]],
    "turned by 180°": [[-1, 0], [0, -1]],
}
"""What may have been done to points that fit no box, as matrices."""


class LawBroken(AssertionError):
    """A source does not keep a law; `law` is its name."""

    def __init__(self, law: Law, what: str) -> None:
        self.law = law.__name__
        super().__init__(f"{self.law}: {what}\n  the law: {law.__doc__}")


class Case:
    """One source, and the scenes, frames and sweeps it is judged by."""

    def __init__(self, source: Any, scenes: int, frames: int) -> None:
        self.source, self._scenes, self._frames = source, scenes, frames

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Spread over the source."""
        every = tuple(self.source.names())
        return tuple(every[k] for k in np.unique(np.linspace(0, len(every) - 1, self._scenes).round().astype(int)))

    @cached_property
    def scenes(self) -> tuple[Scene, ...]:
        return tuple(self.source.load(name) for name in self.names)

    def frames(self, scene: Scene) -> list[int]:
        """Spread over the scene."""
        return np.unique(np.linspace(0, scene.n_frames - 1, self._frames).round().astype(int)).tolist()

    @cached_property
    def recordings(self) -> tuple[list[list[Sweep]], ...]:
        """The sweeps of every scene's frames."""
        return tuple(self.source.sweeps(scene, self.frames(scene)) for scene in self.scenes)

    def sweeps(self) -> Iterator[tuple[str, Scene, int, int, Sweep]]:
        """Every (where, scene, frame, agent, sweep)."""
        for scene, recording in zip(self.scenes, self.recordings, strict=True):
            for t, sweeps in zip(self.frames(scene), recording, strict=True):
                for agent, sweep in enumerate(sweeps):
                    yield f"scene {scene.name}, frame {t}, agent {agent}", scene, t, agent, sweep


Law = Callable[[Case], None]


def it_is_a_source(case: Case) -> None:
    """It has name, digest, names, load and sweeps; name and digest are strings, and the digest can name a folder."""
    source = case.source
    require(isinstance(source, SceneSource), f"{type(source).__name__} lacks name, digest, names, load or sweeps")
    require(bool(source.name) and isinstance(source.name, str), f"its name is {source.name!r}")
    require(_names_a_folder(source.digest), f"its digest is {source.digest!r}")


def names_are_fixed(case: Case) -> None:
    """There are scenes; their names are different, the same each time, and can name folders; others are refused."""
    names = case.source.names()
    require(len(names) > 0, "it has no scene")
    require(len(set(names)) == len(names), "two scenes have one name")
    require(tuple(case.source.names()) == tuple(names), "names() says something else the second time")
    for name in case.names:
        require(_names_a_folder(name), f"a scene is called {name!r}")
        require(case.source.load(name).name == name, f"load({name!r}) gives a scene called otherwise")
    try:
        case.source.load("no such scene")
    except (ValueError, LookupError):
        return
    raise Violation("load('no such scene') raises neither ValueError nor KeyError")


def _names_a_folder(name: object) -> bool:
    return isinstance(name, str) and bool(name) and not set(name) & set("/\\:") and not name.startswith(".")


def arrays_have_their_shapes(case: Case) -> None:
    """pose is (T, M, 3), size (M, 3), connected (A,) of integers, rsu (3,) or None, obstacles (B, 6); T, M, A ≥ 1."""
    for scene in case.scenes:
        require(scene.pose.ndim == 3 and scene.pose.shape[2] == 3, f"scene {scene.name}: pose is {scene.pose.shape}")
        expected = {"size": (scene.pose.shape[1], 3), "connected": (len(scene.connected),)}
        expected["obstacles"] = (len(scene.obstacles), 6)
        if scene.rsu is not None:
            expected["rsu"] = (3,)
        for key, shape in expected.items():
            array = getattr(scene, key)
            require(array.shape == shape, f"scene {scene.name}: {key} is {array.shape}, not {shape}")
            kind = "iu" if key == "connected" else "f"
            require(array.dtype.kind in kind, f"scene {scene.name}: {key} holds {array.dtype}")
        require(scene.pose.dtype.kind == "f", f"scene {scene.name}: pose holds {scene.pose.dtype}")
        require(min(*scene.pose.shape, scene.n_connected) > 0, f"scene {scene.name} is empty")


def numbers_make_sense(case: Case) -> None:
    """Nothing is infinite; a pose is NaN as a whole or not at all; sizes, obstacles and dt are positive."""
    for scene in case.scenes:
        gone = np.isnan(scene.pose)
        require(not np.isinf(scene.pose).any(), f"scene {scene.name}: pose holds infinity")
        require((gone.any(axis=2) == gone.all(axis=2)).all(), f"scene {scene.name}: a pose is NaN in part")
        for key, array in (("size", scene.size), ("obstacles", scene.obstacles), ("rsu", scene.rsu)):
            require(array is None or bool(np.isfinite(array).all()), f"scene {scene.name}: {key} is not finite")
        require((scene.size > 0).all(), f"scene {scene.name}: a size is not positive")
        require((scene.obstacles[:, 3:] > 0).all(), f"scene {scene.name}: an obstacle's size is not positive")
        require(0 < scene.dt < 10, f"scene {scene.name}: dt is {scene.dt}")


def connected_vehicles_are_there(case: Case) -> None:
    """Every connected vehicle is another row, and present in every frame."""
    for scene in case.scenes:
        rows = scene.connected
        require(len(np.unique(rows)) == len(rows), f"scene {scene.name}: connected repeats: {rows.tolist()}")
        inside = ((rows >= 0) & (rows < len(scene.size))).all()
        require(inside, f"scene {scene.name}: connected is {rows.tolist()} of {len(scene.size)} rows")
        gone = rows[np.isnan(scene.pose[:, rows]).any(axis=(0, 2))]
        require(not len(gone), f"scene {scene.name}: connected row {gone[:1]} is absent in a frame")


def rows_keep_their_vehicle(case: Case) -> None:
    """A row is one vehicle for the whole scene: none moves faster than 60 m/s."""
    for scene in case.scenes:
        speed = np.linalg.norm(np.diff(scene.pose[..., :2], axis=0), axis=2) / scene.dt
        worst = np.nanmax(speed, initial=0.0)
        require(worst <= FASTEST, f"scene {scene.name}: a vehicle moves at {worst:.0f} m/s; did rows change owners?")


def vehicles_drive_where_they_look(case: Case) -> None:
    """Headings are counter-clockwise from x: nine in ten moving vehicles (3 m/s) go within 45° of theirs."""
    for scene in case.scenes:
        step = np.diff(scene.pose[..., :2], axis=0)
        yaw = scene.pose[:-1, :, 2]
        along = step[..., 0] * np.cos(yaw) + step[..., 1] * np.sin(yaw)
        length = np.linalg.norm(step, axis=2)
        driving = length > 3 * scene.dt
        share = (along > length * np.cos(np.pi / 4))[driving].mean() if driving.any() else 1.0
        require(share >= 0.9, f"scene {scene.name}: only {share:.0%} do; are the axes right-handed, yaw in radians?")


def sweeps_have_their_shapes(case: Case) -> None:
    """A list for each frame, a sweep for each connected vehicle and then the road-side unit; points (P, 3), P ≥ 1."""
    for scene, recording in zip(case.scenes, case.recordings, strict=True):
        agents = scene.n_connected + (scene.rsu is not None)
        require(len(recording) == len(case.frames(scene)), f"scene {scene.name}: sweeps of {len(recording)} frames")
        require(
            {len(s) for s in recording} == {agents},
            f"scene {scene.name}: sweeps of {[len(s) for s in recording]} agents",
        )
    for where, scene, _, _, sweep in case.sweeps():
        points, origin, hits = sweep.points, sweep.origin, sweep.hits
        require(points.ndim == 2 and points.shape[1] == 3 and points.dtype.kind == "f", f"{where}: {points.shape}")
        require(len(points) > 0, f"{where}: no point")
        require(origin.shape == (3,) and origin.dtype.kind == "f", f"{where}: origin is {origin.shape}")
        if hits is not None:
            require(hits.shape == (len(scene.size),) and hits.dtype.kind in "iu", f"{where}: hits is {hits.shape}")


def sweeps_are_finite(case: Case) -> None:
    """Points and origins hold neither NaN nor infinity; no vehicle is hit less than never."""
    for where, _, _, _, sweep in case.sweeps():
        require(np.isfinite(sweep.points).all(), f"{where}: a point is not finite")
        require(np.isfinite(sweep.origin).all(), f"{where}: the origin is not finite")
        require(sweep.hits is None or bool((sweep.hits >= 0).all()), f"{where}: hits are negative")


def sweeps_begin_at_their_agent(case: Case) -> None:
    """Agent k's origin is the middle of connected vehicle k's box, 0.3 to 6 m up; the last one's, the unit's sensor.

    Maps are laid out from the vehicle: a sensor elsewhere on it hands its points over from there.
    """
    for where, scene, t, agent, sweep in case.sweeps():
        if agent < scene.n_connected:
            place = scene.pose[t, scene.connected[agent], :2]
            require(0.3 <= sweep.origin[2] <= 6, f"{where}: its sensor is {sweep.origin[2]:.2f} m above ground")
        else:
            assert scene.rsu is not None
            place = scene.rsu[:2]
            require(abs(sweep.origin[2] - scene.rsu[2]) <= ANCHOR, f"{where}: height {sweep.origin[2]:.2f} m")
        gap = float(np.linalg.norm(sweep.origin[:2] - place))
        require(gap <= ANCHOR, f"{where}: it begins {gap:.2f} m from its agent")
        require((grid_origin(sweep.origin[:2]) == grid_origin(place)).all(), f"{where}: another grid frame")


def the_road_is_at_zero(case: Case) -> None:
    """z is height above ground: within 15 m of a vehicle, returns lie within 0.5 m of 0, and few below."""
    for where, scene, _, agent, sweep in case.sweeps():
        near = sweep.points[np.linalg.norm(sweep.points[:, :2], axis=1) < NEAR, 2]
        if agent >= scene.n_connected or not len(near):
            continue
        below, road = (near < -ROAD).mean(), (np.abs(near) <= ROAD).mean()
        require(below <= 0.1, f"{where}: {below:.0%} of the returns lie under the road")
        require(road >= 0.02, f"{where}: {road:.0%} of the returns are road; is z that of the sensor?")


def returns_lie_in_their_box(case: Case) -> None:
    """Of the vehicles within 30 m that a sensor meets, 85 % have most of their returns in their box.

    Met are those of which `hits` promises five returns, or which have five, 0.3 m above ground and higher, in their box
    or within 1 m of it and in no other. Boxes are seen from above and grown by 0.2 m.
    """
    good, total = _fitting(case, np.eye(2))
    if good >= SHARE * total:
        return
    found = {name: _fitting(case, np.array(turn, dtype=np.float64)) for name, turn in MISREADINGS.items()}
    name, (better, of) = max(found.items(), key=lambda item: item[1][0] / max(item[1][1], 1))
    hint = (
        f"{better} of {of} would with {name}" if better >= SHARE * of > 0 else "are boxes or points turned or shifted?"
    )
    raise Violation(f"only {good} of {total} have; {hint}")


def _fitting(case: Case, turn: Float[np.ndarray, "2 2"]) -> tuple[int, int]:
    """How many vehicles would hold their returns, of how many, if x and y of the points were `turn` times as given."""
    fits = []
    for _, scene, t, agent, sweep in case.sweeps():
        points = np.column_stack([sweep.points[:, :2] @ turn.T.astype(sweep.points.dtype), sweep.points[:, 2]])
        fits.append(fit(scene, t, agent, Sweep(points, sweep.origin, sweep.hits)))
    return share_inside(fits)


def boxes_hold_their_vehicles(case: Case) -> None:
    """Points are given from the origin along the world's axes: near a sensor, more lie in boxes than round them.

    Counted over all sweeps, 0.3 m above ground and higher, in the box grown by 0.1 m and in a rim 0.5 m wide round it.
    """
    inside, around = 0, 0
    for _, scene, t, agent, sweep in case.sweeps():
        for row in _rows_near(scene, t, agent, sweep):
            solid = sweep.points[sweep.points[:, 2] > 0.3]
            core = _in_box(solid, scene, t, row, sweep, 0.1).sum()
            inside, around = inside + core, around + _in_box(solid, scene, t, row, sweep, 0.6).sum() - core
    require(inside > around, f"{inside} lie inside and {around} in the rim; are the points turned or shifted?")


def hits_lie_in_their_box(case: Case) -> None:
    """A vehicle within 15 m of which `hits` promises returns has as many in its box grown by 0.3 m."""
    for where, scene, t, agent, sweep in case.sweeps():
        if sweep.hits is None:
            continue
        for row in _rows_near(scene, t, agent, sweep):
            found = int(_in_box(sweep.points, scene, t, row, sweep, CLOSE).sum())
            require(sweep.hits[row] <= found, f"{where}: {sweep.hits[row]} hits on row {row}, {found} points there")


def carriers_do_not_see_themselves(case: Case) -> None:
    """Returns from the vehicle that carries the sensor are left out."""
    for where, scene, t, agent, sweep in case.sweeps():
        if agent < scene.n_connected:
            row = int(scene.connected[agent])
            solid = sweep.points[sweep.points[:, 2] > 0.3]
            own = int(_in_box(solid, scene, t, row, sweep, -0.3).sum())
            require(own == 0, f"{where}: {own} points lie inside its own box")


def _rows_near(scene: Scene, t: int, agent: int, sweep: Sweep) -> list[int]:
    """Vehicles within 15 m of the sensor, the carrier left out."""
    near = np.linalg.norm(scene.pose[t, :, :2] - sweep.origin[:2], axis=1) < NEAR  # a NaN compares false
    if agent < scene.n_connected:
        near[scene.connected[agent]] = False
    return [int(row) for row in np.flatnonzero(near)]


def _in_box(
    points: Float[np.ndarray, "P 3"], scene: Scene, t: int, row: int, sweep: Sweep, margin: float
) -> Bool[np.ndarray, " P"]:
    x, y, yaw = scene.pose[t, row] - np.append(sweep.origin[:2], 0.0)
    offset = points[:, :2] - [x, y]
    along = np.abs(offset @ [np.cos(yaw), np.sin(yaw)])
    across = np.abs(offset @ [-np.sin(yaw), np.cos(yaw)])
    length, width, height = scene.size[row] / [2, 2, 1] + margin
    return (along <= length) & (across <= width) & (points[:, 2] <= height)


def frames_do_not_depend_on_their_batch(case: Case) -> None:
    """Sweeps of a frame are the same alone, in another order, and asked for twice."""
    for scene, recording in zip(case.scenes, case.recordings, strict=True):
        frames = case.frames(scene)
        again = case.source.sweeps(scene, [*frames[::-1], frames[0]])
        for t, kept, repeated in zip([*frames[::-1], frames[0]], [*recording[::-1], recording[0]], again, strict=True):
            _require_same(kept, repeated, f"scene {scene.name}, frame {t}, in another batch")


def loading_again_changes_nothing(case: Case) -> None:
    """`load` gives the same scene each time, bit for bit."""
    for scene in case.scenes:
        again = case.source.load(scene.name)
        for key in ("pose", "size", "connected", "rsu", "obstacles"):
            a, b = getattr(scene, key), getattr(again, key)
            require((a is None) == (b is None), f"scene {scene.name}: {key} comes and goes")
            require(
                a is None or np.array_equal(a, b, equal_nan=a.dtype.kind == "f"), f"scene {scene.name}: {key} differs"
            )


def frames_outside_are_refused(case: Case) -> None:
    """A frame after the last raises a ValueError or an IndexError."""
    scene = case.scenes[0]
    try:
        case.source.sweeps(scene, [scene.n_frames])
    except (ValueError, IndexError):
        return
    raise Violation(f"scene {scene.name}: frame {scene.n_frames} of {scene.n_frames} was given")


def pickling_changes_nothing(case: Case) -> None:
    """A pickled source has the same digest, names, scenes and sweeps: other processes read the same."""
    twin = pickle.loads(pickle.dumps(case.source))
    require(twin.digest == case.source.digest, f"the digest becomes {twin.digest!r}")
    require(tuple(twin.names()) == tuple(case.source.names()), "the names change")
    scene, recording = case.scenes[0], case.recordings[0]
    repeated = twin.sweeps(twin.load(scene.name), case.frames(scene)[:1])
    _require_same(recording[0], repeated[0], f"scene {scene.name}, of the unpickled source")


def _require_same(kept: list[Sweep], repeated: list[Sweep], where: str) -> None:
    require(len(kept) == len(repeated), f"{where}: {len(repeated)} sweeps, not {len(kept)}")
    for agent, (a, b) in enumerate(zip(kept, repeated, strict=True)):
        same = np.array_equal(a.points, b.points) and np.array_equal(a.origin, b.origin)
        same &= a.hits is b.hits if a.hits is None or b.hits is None else np.array_equal(a.hits, b.hits)
        require(same, f"{where}: agent {agent} has another sweep")


LAWS: tuple[Law, ...] = (
    it_is_a_source,
    names_are_fixed,
    arrays_have_their_shapes,
    numbers_make_sense,
    connected_vehicles_are_there,
    rows_keep_their_vehicle,
    vehicles_drive_where_they_look,
    sweeps_have_their_shapes,
    sweeps_are_finite,
    sweeps_begin_at_their_agent,
    the_road_is_at_zero,
    returns_lie_in_their_box,
    boxes_hold_their_vehicles,
    hits_lie_in_their_box,
    carriers_do_not_see_themselves,
    frames_do_not_depend_on_their_batch,
    loading_again_changes_nothing,
    frames_outside_are_refused,
    pickling_changes_nothing,
)


def check_scenes(source: Any, *, scenes: int = 2, frames: int = 3, skip: Collection[str] = ()) -> tuple[str, ...]:
    """Check a scene source against every law.

    Args:
        source: the `SceneSource`, or a string that names it.
        scenes: how many scenes, spread over the source, it is judged by.
        frames: how many frames of each.
        skip: names of laws that do not apply, such as "boxes_hold_their_vehicles" where noise displaces the points.

    Returns:
        The names of the laws that were checked, all of them kept.

    Raises:
        LawBroken: an `AssertionError` that names the first law broken and says what happened.
        ValueError: an unknown name in `skip`, no scenes or no frames, or a name that names no source.
    """
    if scenes < 1 or frames < 1:
        raise ValueError(f"scenes and frames must be at least 1, got {scenes} and {frames}")
    known = [law.__name__ for law in LAWS]
    if unknown := sorted(set(skip) - set(known)):
        raise ValueError(f"no laws called {unknown}; the laws are {known}")
    case = Case(open_source(source) if isinstance(source, str) else source, scenes, frames)
    kept = [law for law in LAWS if law.__name__ not in skip]
    for law in kept:
        try:
            law(case)
        except Violation as violation:
            raise LawBroken(law, str(violation)) from None
        except Exception as error:
            raise LawBroken(law, f"the source raised {type(error).__name__}: {error}") from error
    return tuple(law.__name__ for law in kept)
