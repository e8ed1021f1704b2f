"""Any source's scenes in the layout of OPV2V, V2V4Real or V2X-Real, for other people's tools and for round trips.

Convention, OPV2V:
    Vehicles are numbered from 1001 on, the connected ones first and in order, so that sorting their names as text keeps
    the ego first; the road-side unit is -1. A file's number is its time in CARLA's ticks of 0.05 s. Every agent lists
    every vehicle that is there (OPV2V: those it met with a ray). Ground is at z = 0. Buildings are not written: the
    layout has no place for them, and the sweeps show them.
Convention, V2V4Real and V2X-Real (see `v2v4real` and `v2x_real`):
    Agents are called 0, 1, … or 1, 2, …; a vehicle is listed by all agents but the one that carries its sensor, under
    numbers that are no agent's. Files are numbered by 0.1 s. V2V4Real has no road-side unit.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from cp_env.progress import track
from cp_env.scenes.formats import pcd
from cp_env.scenes.opv2v.axes import from_carla, mirrored, to_carla
from cp_env.scenes.opv2v.layouts import OPV2V, V2V4REAL, V2X_REAL, Layout
from cp_env.types import Scene, SceneSource, Sweep

FIRST = 1001
APART = 100  # by so much the numbers of V2V4Real's agents differ
LAYOUTS = {layout.kind: layout for layout in (OPV2V, V2V4REAL, V2X_REAL)}
Entry = dict[str, Any]  # one vehicle, by OPV2V's keys
_AT_ONCE = 8  # frames whose sweeps are in memory


def write(source: SceneSource, names: Sequence[str], out: Path, *, data: str = "binary", kind: str = "opv2v") -> None:
    """Write scenes of `source`, each into a folder of its own in `out`.

    Args:
        source: any source.
        names: of its scenes.
        out: a folder.
        data: encoding of the points, "binary" or "ascii"; V2X-Real has its own.
        kind: "opv2v", "v2v4real" or "v2x-real".

    Raises:
        ValueError: the time between two frames is no whole number of ticks, or unknown encoding or kind.
    """
    if kind not in LAYOUTS:
        raise ValueError(f"kind must be one of {', '.join(LAYOUTS)}; got {kind!r}")
    for name in track(names, f"writing {source.name}", unit="scene"):
        _write(source, name, out, data, LAYOUTS[kind])


def _write(source: SceneSource, name: str, out: Path, data: str, layout: Layout) -> None:
    scene = source.load(name)
    ticks = round(scene.dt / layout.tick)
    if ticks < 1 or abs(ticks * layout.tick - scene.dt) > 1e-6:
        raise ValueError(
            f"{layout.title} numbers its frames by {layout.tick} s; the frames of scene {name!r} are {scene.dt} s apart"
        )
    folder = out / name
    agents = _agents(scene, layout)
    for agent in agents:
        (folder / agent).mkdir(parents=True, exist_ok=True)
    starts = range(0, scene.n_frames, _AT_ONCE)
    for start in starts:
        frames = range(start, min(start + _AT_ONCE, scene.n_frames))
        for t, sweeps in zip(frames, source.sweeps(scene, frames), strict=True):
            for k, (agent, sweep) in enumerate(zip(agents, sweeps, strict=False)):
                stem = folder / agent / f"{ticks * t:06d}"
                own = int(scene.connected[k]) if k < scene.n_connected else None
                yaw = 0.0 if own is None else float(scene.pose[t, own, 2])
                if layout == OPV2V:
                    x, y, z = sweep.origin.tolist()
                    lidar = to_carla(x, y, z, yaw)
                    stem.with_suffix(".yaml").write_text(_carla_note(scene, t, own, lidar))
                    points = mirrored(_points(sweep, from_carla(np.array(lidar))[:, :3]))
                else:
                    stem.with_suffix(".yaml").write_text(_real_note(scene, t, k, own, sweep.origin, yaw, layout))
                    points = _points(sweep, _turn(yaw))
                if layout == V2X_REAL:
                    rows = np.column_stack([points, np.zeros(len(points))]).astype("<f4")
                    stem.with_suffix(".bin").write_bytes(rows.tobytes())
                else:
                    pcd.write(stem.with_suffix(".pcd"), points, data=data)


def _agents(scene: Scene, layout: Layout) -> list[str]:
    number = _numbers(scene)
    if layout == OPV2V:
        vehicles = [str(number[row]) for row in scene.connected.tolist()]
    else:
        vehicles = [str(k + (layout == V2X_REAL)) for k in range(scene.n_connected)]
    return vehicles + (["-1"] if scene.rsu is not None and layout != V2V4REAL else [])


def _carla_note(scene: Scene, t: int, own: int | None, lidar: list[float]) -> str:
    number = _numbers(scene)
    vehicles = _vehicles(scene, t, number)
    return _yaml(lidar, None if own is None else vehicles[number[own]], vehicles)


def _real_note(
    scene: Scene, t: int, agent: int, own: int | None, origin: Float[np.ndarray, " 3"], yaw: float, layout: Layout
) -> str:
    """One agent's file of V2V4Real or V2X-Real: boxes by their middle, on level ground at z = 0."""
    import yaml

    local = layout.local_boxes
    vehicles = {}
    for row in np.flatnonzero(~np.isnan(scene.pose[t, :, 0])).tolist():
        if row == own:
            continue
        middle = np.array([*scene.pose[t, row, :2], scene.size[row, 2] / 2])
        heading = float(scene.pose[t, row, 2])
        place = (middle - origin) @ _turn(yaw) if local else middle
        entry: Entry = {
            "angle": [0.0, (heading - yaw + np.pi) % (2 * np.pi) - np.pi if local else float(np.rad2deg(heading)), 0.0],
            "center": [0.0, 0.0, 0.0],
            "extent": (scene.size[row] / 2).tolist(),
            "location": place.tolist(),
            "obj_type": "Car",
        }
        if local:
            entry["ass_id"] = -1 if row in scene.connected.tolist() else row + 1
        vehicles[row + 1 + (APART * agent if local else APART)] = entry
    pose: Any = [*origin.tolist(), 0.0, float(np.rad2deg(yaw)), 0.0]
    if local:
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = _turn(yaw), origin
    said = {"ego_speed": 0.0, "lidar_pose": pose, "true_ego_pose": pose, "vehicles": vehicles}
    return str(yaml.dump(said))


def _turn(yaw: float) -> Float[np.ndarray, "3 3"]:
    """The rotation by `yaw` rad about z."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _numbers(scene: Scene) -> dict[int, int]:
    """The number of each row."""
    others = np.setdiff1d(np.arange(len(scene.size)), scene.connected)
    return {row: FIRST + k for k, row in enumerate([*scene.connected.tolist(), *others.tolist()])}


def _points(sweep: Sweep, world_R_sensor: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "P 3"]:
    """The sweep's points along the axes of its sensor."""
    offset = sweep.points - np.array([0.0, 0.0, sweep.origin[2]])
    return np.asarray(offset @ world_R_sensor)


def _vehicles(scene: Scene, t: int, number: dict[int, int]) -> dict[int, Entry]:
    """The entries of all vehicles of one frame: origins on the ground under the middle of their boxes."""
    entries: dict[int, Entry] = {}
    for row in np.flatnonzero(~np.isnan(scene.pose[t, :, 0])).tolist():
        x, y, yaw = scene.pose[t, row].tolist()
        pose = to_carla(x, y, 0.0, yaw)
        half = (scene.size[row] / 2).tolist()
        entries[number[row]] = {
            "location": pose[:3],
            "angle": pose[3:],
            "center": [0.0, 0.0, half[2]],
            "extent": half,
            "speed": _speed(scene, t, row),
        }
    return dict(sorted(entries.items()))


def _speed(scene: Scene, t: int, row: int) -> float:
    """From the frame before (after, in the first); 0 if it was not there; km/h."""
    a, b = (t - 1, t) if t else (0, min(1, scene.n_frames - 1))
    step = float(np.hypot(*(scene.pose[b, row, :2] - scene.pose[a, row, :2])))
    return 0.0 if np.isnan(step) else 3.6 * step / scene.dt


def _yaml(lidar: list[float], body: Entry | None, vehicles: dict[int, Entry]) -> str:
    """One agent's file: plain YAML, a vehicle a line. A road-side unit has no body: its sensor stands for it."""
    pose = lidar if body is None else [*body["location"], *body["angle"]]
    poses = {"lidar_pose": lidar, "predicted_ego_pos": pose, "true_ego_pos": pose}
    lines = [
        f"ego_speed: {_text(0.0 if body is None else body['speed'])}",
        *(f"{key}: {_text(value)}" for key, value in poses.items()),
        "vehicles:",
        *(
            f"  {number}: {{{', '.join(f'{k}: {_text(v)}' for k, v in entry.items())}}}"
            for number, entry in vehicles.items()
        ),
    ]
    return "\n".join(lines) + "\n"


def _text(value: Any) -> str:
    """To the micrometre; never as 1e-07, which YAML 1.1 reads as a word."""
    return f"[{', '.join(map(_text, value))}]" if isinstance(value, list) else f"{value:.6f}"
