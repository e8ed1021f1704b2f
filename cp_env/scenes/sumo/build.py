"""Build a scene from a drive through a network: select vehicles, furnish the streets round them, keep what is near."""

from __future__ import annotations

import tempfile
import zlib
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import shapely
from jaxtyping import Float, Int

from cp_env.scenes.formats.recording import wrap
from cp_env.scenes.sumo import roadside, selection, traffic
from cp_env.scenes.sumo.network import Streets, build_streets, draw_streets
from cp_env.scenes.sumo.regimes import Pace, Regime, draw_selection
from cp_env.scenes.sumo.roadside import footprints
from cp_env.types import Scene

REACH = 90.0  # m round the ego's path: what is farther off is not kept
TRIES = 40
SECONDS = 240.0  # s of traffic of which a scene is drawn


def record(name: str, regime: Regime, pace: Pace, seed: int) -> Scene:
    """One scene, a function of its arguments alone (and of the version of SUMO).

    Streets, crowd, drive, window and ego are drawn. A drive without a fitting window or whose connected vehicles SUMO
    drove through each other is drawn anew; there is no other choice among drafts.
    """
    for attempt in range(TRIES):
        rng = np.random.default_rng([seed, zlib.crc32(name.encode()), attempt])
        with tempfile.TemporaryDirectory() as folder:
            town = build_streets(*draw_streets(regime.streets, rng), Path(folder))
            tracks = traffic.drive(town, Path(folder), rng, crowd=int(rng.integers(*regime.crowd)), seconds=SECONDS)
        selected = draw_selection(tracks, town, regime, pace, rng)
        if selected is None:
            continue
        scene = build_scene(name, regime.style, town, tracks, selected, rng)
        if scene is not None:
            return scene
    raise RuntimeError(f"scene {name!r}: no window with enough vehicles in radio range in {TRIES} networks")


@dataclass(frozen=True, eq=False)
class Furnished:
    """A scene, and how it lies in the network that it was taken from."""

    scene: Scene
    n_moving: int  # the first rows are vehicles of the simulation, the others are parked
    angle: float  # the world is turned by so much; rad
    origin: Float[np.ndarray, " 2"]  # of the world in the network's frame; m

    def to_world(self, pose: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
        """Poses of the network's frame in the scene's world frame; m, rad."""
        return _moved(pose, self.angle, self.origin)

    def to_network(self, pose: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
        """The other way round."""
        back = _moved(pose, -self.angle, np.zeros(2))
        back[..., :2] += self.origin
        return back


def build_scene(
    name: str,
    kind: str,
    town: Streets,
    tracks: traffic.Tracks,
    selected: selection.VehicleSelection,
    rng: np.random.Generator,
    buildings: Float[np.ndarray, "B 6"] | None = None,
) -> Scene | None:
    """The scene of `furnish_scene` alone."""
    built = furnish_scene(name, kind, town, tracks, selected, rng, buildings)
    return None if built is None else built.scene


def furnish_scene(
    name: str,
    kind: str,
    town: Streets,
    tracks: traffic.Tracks,
    selected: selection.VehicleSelection,
    rng: np.random.Generator,
    buildings: Float[np.ndarray, "B 6"] | None = None,
) -> Furnished | None:
    """Furnish the streets round one selection; None if SUMO drove two of the connected through each other.

    Args:
        name: of the scene.
        kind: "urban", "suburban" or "intersection": what stands along the streets.
        town: the streets.
        tracks: everyone who drives.
        selected: the window and the connected vehicles.
        rng: draws what stands along the streets, and how the world is turned.
        buildings: boxes that stand there instead of houses.
    """
    pose = tracks.pose[selected.start : selected.start + selection.FRAMES].copy()
    path = pose[:, selected.connected[0], :2]
    pose[np.linalg.norm(pose[:, :, None, :2] - path[None, None, ::10], axis=-1).min(axis=2) > REACH] = np.nan
    kept = _peaceful(pose, tracks.size, selected.connected)
    if not np.isin(selected.connected, kept).all():
        return None
    pose, size = pose[:, kept], tracks.size[kept]
    still = roadside.furnish(town, kind, path, _swept(pose, size), rng, REACH, buildings)
    parked = np.repeat(still.pose[None], len(pose), axis=0)
    rsu = roadside.place_rsu(town, still, path, rng) if len(town.junctions) else None
    angle, origin = rng.uniform(-np.pi, np.pi), path.mean(axis=0)
    if rsu is not None:
        rsu = np.concatenate([_turn(angle) @ (rsu[:2] - origin), rsu[2:]])
    scene = Scene(
        name=name,
        kind=kind,
        dt=traffic.DT,
        pose=_moved(np.concatenate([pose, parked], axis=1), angle, origin),
        size=np.concatenate([size, still.size]),
        connected=np.searchsorted(kept, selected.connected),
        rsu=rsu,
        obstacles=_moved(still.obstacles, angle, origin),
    )
    return Furnished(scene, len(kept), angle, origin)


def _peaceful(
    pose: Float[np.ndarray, "T M 3"], size: Float[np.ndarray, "M 3"], connected: Int[np.ndarray, " A"]
) -> Int[np.ndarray, " K"]:
    """Rows ever present, less one of every two that SUMO drove through each other (a connected one goes last)."""
    drop = np.isnan(pose[..., 0]).all(axis=0)
    for a, b in _clashes(pose, size):
        if not (drop[a] or drop[b]):
            drop[b if a in connected else a] = True
    return np.flatnonzero(~drop)


def _clashes(pose: Float[np.ndarray, "T M 3"], size: Float[np.ndarray, "M 3"]) -> list[tuple[int, int]]:
    pairs: set[tuple[int, int]] = set()
    for frame in pose:
        here = np.flatnonzero(~np.isnan(frame[:, 0]))
        shapes = footprints(np.column_stack([frame[here], size[here] - 0.04]))
        a, b = shapely.STRtree(shapes).query(shapes, predicate="intersects")
        pairs.update((int(here[i]), int(here[j])) for i, j in zip(a, b, strict=True) if i < j)
    return sorted(pairs)


def _swept(pose: Float[np.ndarray, "T M 3"], size: Float[np.ndarray, "M 3"]) -> np.ndarray:
    """Polygons that cover all the ground driven over: hulls of each vehicle's boxes three frames apart."""
    stations = pose[np.unique([*range(0, len(pose), 3), len(pose) - 1])]
    hulls = []
    for a, b in pairwise(stations):
        begin, end = (np.where(np.isnan(x), y, x) for x, y in ((a, b), (b, a)))
        rows = np.flatnonzero(~np.isnan(begin[:, 0]))
        ends = [footprints(np.column_stack([where[rows], size[rows]])) for where in (begin, end)]
        hulls.append(shapely.convex_hull(shapely.multipolygons(np.stack(ends, axis=1))))
    return np.concatenate(hulls)


def _turn(angle: float) -> Float[np.ndarray, "2 2"]:
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def _moved(rows: Float[np.ndarray, "*n d"], angle: float, origin: Float[np.ndarray, " 2"]) -> Float[np.ndarray, "*n d"]:
    """Rows that begin with x, y, yaw, turned by `angle` about `origin`, which becomes (0, 0)."""
    place, yaw, rest = rows[..., :2], rows[..., 2:3], rows[..., 3:]
    return np.concatenate([(place - origin) @ _turn(angle).T, wrap(yaw + angle), rest], axis=-1)
