"""Any source's scenes in the raw layout of V2X-Sim 2.0, which the nuScenes devkit reads.

Convention: ground is at z = 0 in the world. An ego pose is where the sweep was taken, on the ground, with the carrier's
heading; the LiDAR stands upright above it, turned like its carrier. The road-side unit is agent 0, the ego agent 1.
Buildings are not written: the layout has no place for them, and the sweeps show them. Intensity and ring are 0.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import IO, Any

import numpy as np
from jaxtyping import Float
from PIL import Image

from cp_env.geometry import spatial
from cp_env.progress import Progress
from cp_env.types import Scene, SceneSource, Sweep

VERSION = "v2.0"
_TABLES = (
    "category",
    "attribute",
    "visibility",
    "instance",
    "sensor",
    "calibrated_sensor",
    "ego_pose",
    "log",
    "scene",
    "sample",
    "sample_data",
    "sample_annotation",
    "map",
)
_CATEGORIES = ("vehicle.car", "vehicle.truck", "vehicle.bus.rigid")
_LONG, _HIGH, _BUS = 6.5, 3.0, 10.0  # m; a truck is longer and higher, a bus longer
_AT_ONCE = 8  # frames whose sweeps are in memory


def write(source: SceneSource, names: Sequence[str], root: Path) -> None:
    """Write scenes of `source` into `root`: `v2.0/*.json`, `sweeps/LIDAR_TOP_id_k/*.pcd.bin`, an empty map."""
    scenes = [source.load(name) for name in names]
    (root / VERSION).mkdir(parents=True, exist_ok=True)
    (root / "maps").mkdir(exist_ok=True)
    Image.new("L", (8, 8)).save(root / "maps" / "empty.png")
    with ExitStack() as stack:
        tables = _Tables(root / VERSION, stack)
        _write_common(tables, 1 + max(scene.n_connected for scene in scenes))
        bar = stack.enter_context(Progress(f"writing {root}", sum(scene.n_frames for scene in scenes), "frame"))
        for scene in scenes:
            for start in range(0, scene.n_frames, _AT_ONCE):
                frames = range(start, min(start + _AT_ONCE, scene.n_frames))
                for frame, sweeps in zip(frames, source.sweeps(scene, frames), strict=True):
                    agents = dict(zip(_agents(scene), sweeps, strict=True))
                    if not frame:
                        mounts = {agent: float(sweep.origin[2]) for agent, sweep in agents.items()}
                        _write_scene(tables, scene, mounts)
                    _write_frame(tables, scene, frame, agents, mounts)
                    for agent, sweep in agents.items():
                        points = _in_sensor(sweep, _yaw(scene, frame, agent))
                        _write_points(root / _file(scene, frame, agent), points)
                    bar.advance()


class _Tables:
    """The tables, open for writing; a record is written when it is known."""

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        self._files: dict[str, IO[str]] = {}
        for name in _TABLES:
            file = self._files[name] = stack.enter_context((folder / f"{name}.json").open("w", encoding="utf-8"))
            file.write("[")
            stack.callback(file.write, "\n]\n")  # runs before the file closes
        self._begun: set[str] = set()

    def add(self, table: str, token: str, **fields: Any) -> None:
        self._files[table].write(("\n" if table not in self._begun else ",\n") + json.dumps({"token": token, **fields}))
        self._begun.add(table)


def _token(*words: object) -> str:
    """32 hexadecimal digits that stand for `words`."""
    return hashlib.md5(repr(words).encode(), usedforsecurity=False).hexdigest()


def _agents(scene: Scene) -> list[int]:
    """The channel of each sweep."""
    return [*range(1, scene.n_connected + 1), *([0] if scene.rsu is not None else [])]


def _file(scene: Scene, frame: int, agent: int) -> str:
    return f"sweeps/LIDAR_TOP_id_{agent}/{scene.name}_{frame:06d}.pcd.bin"


def _write_common(tables: _Tables, agents: int) -> None:
    for category in _CATEGORIES:
        tables.add("category", _token("category", category), name=category, description="")
    for agent in range(agents):
        tables.add("sensor", _token("sensor", agent), channel=f"LIDAR_TOP_id_{agent}", modality="lidar")
    tables.add("visibility", "1", level="v0-100", description="not measured")
    tables.add("log", _token("log"), logfile="", vehicle="", date_captured="2000-01-01", location="exported")
    tables.add("map", _token("map"), category="none", filename="maps/empty.png", log_tokens=[_token("log")])


def _write_scene(tables: _Tables, scene: Scene, mounts: dict[int, float]) -> None:
    """What a scene's frames refer to; `mounts` are the heights of its LiDARs above ground in the first frame."""
    name, last = scene.name, scene.n_frames - 1
    tables.add(
        "scene",
        _token("scene", name),
        name=name,
        description=scene.kind,
        log_token=_token("log"),
        nbr_samples=scene.n_frames,
        first_sample_token=_token("sample", name, 0),
        last_sample_token=_token("sample", name, last),
    )
    for agent, height in mounts.items():
        tables.add(
            "calibrated_sensor",
            _token("mount", name, agent),
            sensor_token=_token("sensor", agent),
            translation=[0.0, 0.0, height],
            rotation=[1.0, 0.0, 0.0, 0.0],
            camera_intrinsic=[],
        )
    for row, present in enumerate(~np.isnan(scene.pose[..., 0]).T):
        frames = np.flatnonzero(present)
        if len(frames):
            tables.add(
                "instance",
                _token("instance", name, row),
                category_token=_token("category", _category(scene.size[row])),
                nbr_annotations=len(frames),
                first_annotation_token=_token("box", name, frames[0], row),
                last_annotation_token=_token("box", name, frames[-1], row),
            )


def _write_frame(tables: _Tables, scene: Scene, frame: int, agents: dict[int, Sweep], mounts: dict[int, float]) -> None:
    name, stamp = scene.name, round(1e6 * (1 + scene.dt * frame))
    sample = _token("sample", name, frame)
    tables.add(
        "sample", sample, timestamp=stamp, scene_token=_token("scene", name), **_neighbours(scene, frame, "sample")
    )
    for agent, sweep in agents.items():
        x, y, z = sweep.origin.tolist()
        tables.add(
            "ego_pose",
            _token("pose", name, frame, agent),
            timestamp=stamp,
            translation=[x, y, z - mounts[agent]],
            rotation=spatial.upright(_yaw(scene, frame, agent)).tolist(),
        )
        tables.add(
            "sample_data",
            _token("sweep", name, frame, agent),
            sample_token=sample,
            ego_pose_token=_token("pose", name, frame, agent),
            calibrated_sensor_token=_token("mount", name, agent),
            filename=_file(scene, frame, agent),
            fileformat="pcd",
            timestamp=stamp,
            is_key_frame=True,
            width=0,
            height=0,
            **_neighbours(scene, frame, "sweep", agent),
        )
    hits = sum(sweep.hits for sweep in agents.values() if sweep.hits is not None)
    for row in np.flatnonzero(~np.isnan(scene.pose[frame, :, 0])).tolist():
        _write_box(tables, scene, frame, row, int(np.broadcast_to(hits, len(scene.size))[row]))


def _write_box(tables: _Tables, scene: Scene, frame: int, row: int, hits: int) -> None:
    name, (x, y, yaw), (length, width, height) = scene.name, scene.pose[frame, row].tolist(), scene.size[row].tolist()
    frames = np.flatnonzero(~np.isnan(scene.pose[:, row, 0])).tolist()
    at = frames.index(frame)
    tables.add(
        "sample_annotation",
        _token("box", name, frame, row),
        sample_token=_token("sample", name, frame),
        instance_token=_token("instance", name, row),
        visibility_token="1",
        attribute_tokens=[],
        translation=[x, y, height / 2],
        size=[width, length, height],
        rotation=spatial.upright(np.array(yaw)).tolist(),
        num_lidar_pts=hits,
        num_radar_pts=0,
        prev=_token("box", name, frames[at - 1], row) if at else "",
        next=_token("box", name, frames[at + 1], row) if at + 1 < len(frames) else "",
    )


def _neighbours(scene: Scene, frame: int, what: str, *of: int) -> dict[str, str]:
    """`prev` and `next` of a chain over all frames; empty at its ends."""
    return {
        word: _token(what, scene.name, other, *of) if 0 <= other < scene.n_frames else ""
        for word, other in (("prev", frame - 1), ("next", frame + 1))
    }


def _category(size: Float[np.ndarray, " 3"]) -> str:
    length, _, height = size.tolist()
    return _CATEGORIES[2] if length > _BUS else _CATEGORIES[1] if length > _LONG and height > _HIGH else _CATEGORIES[0]


def _yaw(scene: Scene, frame: int, agent: int) -> Float[np.ndarray, ""]:
    """Heading of an agent in the world; the road-side unit looks east."""
    return np.array(scene.pose[frame, scene.connected[agent - 1], 2] if agent else 0.0)


def _in_sensor(sweep: Sweep, yaw: Float[np.ndarray, ""]) -> Float[np.ndarray, "P 3"]:
    """The points in the sensor's own frame; m."""
    height = np.array([0, 0, sweep.origin[2]])
    return (sweep.points - height) @ spatial.rotation(spatial.upright(yaw))


def _write_points(path: Path, points: Float[np.ndarray, "P 3"]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    np.pad(points.astype(np.float32), ((0, 0), (0, 2))).tofile(path)
