"""Any source's scenes in the layout of OPV2V, for other people's tools and for round trips.

Convention: vehicles are numbered from 1001 on, the connected ones first and in order, so that sorting their names as
text keeps the ego first; the road-side unit is -1. A file's number is its time in CARLA's ticks of 0.05 s. Every agent
lists every vehicle that is there (OPV2V: those it met with a ray). Ground is at z = 0. Buildings are not written: the
layout has no place for them, and the sweeps show them.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from tqdm import tqdm

from cp_env.scenes.formats import pcd
from cp_env.scenes.opv2v.axes import from_carla, mirrored, to_carla
from cp_env.types import Scene, SceneSource, Sweep

TICK = 0.05  # s
FIRST = 1001
Entry = dict[str, Any]  # one vehicle, by OPV2V's keys
_AT_ONCE = 8  # frames whose sweeps are in memory


def write(source: SceneSource, names: Sequence[str], out: Path, *, data: str = "binary") -> None:
    """Write scenes of `source`, each into a folder of its own in `out`.

    Args:
        data: encoding of the points, "binary" or "ascii".

    Raises:
        ValueError: the time between two frames is no whole number of ticks, or unknown encoding.
    """
    for name in tqdm(names, f"writing {source.name}", unit="scene"):
        _write(source, name, out, data)


def _write(source: SceneSource, name: str, out: Path, data: str) -> None:
    scene = source.load(name)
    ticks = round(scene.dt / TICK)
    if ticks < 1 or abs(ticks * TICK - scene.dt) > 1e-6:
        raise ValueError(f"OPV2V numbers its frames by {TICK} s; the frames of scene {name!r} are {scene.dt} s apart")
    folder, number = out / name, _numbers(scene)
    agents = [str(number[row]) for row in scene.connected.tolist()] + (["-1"] if scene.rsu is not None else [])
    for agent in agents:
        (folder / agent).mkdir(parents=True, exist_ok=True)
    starts = range(0, scene.n_frames, _AT_ONCE)
    for start in tqdm(starts, f"writing {name}", leave=False, unit_scale=_AT_ONCE, unit="frame"):
        frames = range(start, min(start + _AT_ONCE, scene.n_frames))
        for t, sweeps in zip(frames, source.sweeps(scene, frames), strict=True):
            vehicles = _vehicles(scene, t, number)
            for k, (agent, sweep) in enumerate(zip(agents, sweeps, strict=True)):
                stem = folder / agent / f"{ticks * t:06d}"
                yaw = float(scene.pose[t, scene.connected[k], 2]) if k < scene.n_connected else 0.0
                x, y, z = sweep.origin.tolist()
                lidar = to_carla(x, y, z, yaw)
                body = vehicles[int(agent)] if k < scene.n_connected else None
                stem.with_suffix(".yaml").write_text(_yaml(lidar, body, vehicles))
                pcd.write(stem.with_suffix(".pcd"), _points(sweep, lidar), data=data)


def _numbers(scene: Scene) -> dict[int, int]:
    """The number of each row."""
    others = np.setdiff1d(np.arange(len(scene.size)), scene.connected)
    return {row: FIRST + k for k, row in enumerate([*scene.connected.tolist(), *others.tolist()])}


def _points(sweep: Sweep, lidar: list[float]) -> Float[np.ndarray, "P 3"]:
    """The sweep's points in CARLA's frame of its sensor."""
    rotation = from_carla(np.array(lidar))[:, :3]
    offset = sweep.points - np.array([0.0, 0.0, sweep.origin[2]])
    return mirrored(offset @ rotation)


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
