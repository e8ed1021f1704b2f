"""The file of one recorded scene: compressed numpy arrays of small integers, nothing pickled.

Convention:
    Lengths are stored in centimetres, angles in milliradians. Moving vehicles are stored as differences from frame to
    frame (an absent vehicle keeps its last place and is masked), vehicles that stand for the whole scene only once.
    Rows of a `Scene` read back: the moving vehicles, then the parked ones.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int

from cp_env.scenes.formats.bounded import read_bytes
from cp_env.scenes.formats.plain_numpy import NPZ_BYTES, load_npz
from cp_env.types import Scene

VERSION = 1

MAX_POSES = 10_000_000
"""Frames times vehicles of a recording, at most."""

_LENGTH, _ANGLE = 0.01, 0.001
_POSE = np.array([_LENGTH, _LENGTH, _ANGLE])
_BOX = np.array([_LENGTH, _LENGTH, _ANGLE, _LENGTH, _LENGTH, _LENGTH])

_LAYOUT = {
    "version": ("i8", 0),
    "kind": ("U", 0),
    "dt": ("f8", 0),
    "present": ("u1", 2),
    "first": ("i4", 2),
    "steps": ("i2", 3),
    "parked": ("i4", 2),
    "size": ("i2", 2),
    "connected": ("i2", 1),
    "rsu": ("i4", 1),
    "obstacles": ("i4", 2),
}
"""Type and number of axes of each array."""


def write(path: Path, scene: Scene) -> None:
    """Store `scene` in `path` (npz). Rows are reordered: vehicles that ever move or are absent first."""
    change = np.abs(scene.pose - scene.pose[:1]).max(axis=(0, 2))
    parked = np.flatnonzero(change == 0)  # NaN compares false: an absent vehicle is not parked
    moving = np.setdiff1d(np.arange(len(scene.size)), parked)
    order = np.concatenate([moving, parked])
    pose = scene.pose[:, moving]
    present = ~np.isnan(pose[..., 0])
    steps = np.round(_hold(pose, present) / _POSE).astype(np.int64)
    arrays = {
        "version": np.array(VERSION),
        "kind": np.array(scene.kind),
        "dt": np.array(scene.dt),
        "present": np.packbits(present, axis=0),
        "first": steps[0].astype(np.int32),
        "steps": np.diff(steps, axis=0).astype(np.int16),
        "parked": np.round(scene.pose[0, parked] / _POSE).astype(np.int32),
        "size": np.round(scene.size[order] / _LENGTH).astype(np.int16),
        "connected": np.argsort(order)[scene.connected].astype(np.int16),
        "rsu": np.round(np.atleast_1d([] if scene.rsu is None else scene.rsu) / _LENGTH).astype(np.int32),
        "obstacles": np.round(scene.obstacles / _BOX).astype(np.int32),
    }
    with path.open("wb") as file:  # not a path: numpy would append a suffix to it
        np.savez_compressed(file, **arrays)


def read(path: Path, name: str) -> Scene:
    """The scene stored in `path`.

    Raises:
        ValueError: the file is missing, broken, of another version, or larger than the bounds of `plain_numpy` and
            `MAX_POSES`; the message names it.
    """
    data = content(path, name)
    try:
        arrays = load_npz(data)
        if "version" in arrays and arrays["version"].tolist() != VERSION:
            raise ValueError(f"version {str(arrays['version'])[:40]}, this program reads {VERSION}")
        _check(arrays)
        return _unpack(arrays, name)
    except ValueError as error:
        raise ValueError(f"recording {path} is broken ({error}); reinstall or record it again") from error


def content(path: Path, name: str) -> bytes:
    """The bytes of the recording of scene `name`.

    Raises:
        ValueError: `path` cannot be read.
    """
    try:
        return read_bytes(path, NPZ_BYTES)
    except (OSError, ValueError) as error:
        raise ValueError(f"scene {name!r} needs the recording {path}: {error}; reinstall or record it again") from error


def _check(arrays: dict[str, np.ndarray]) -> None:
    """ValueError unless the arrays are those of a recording, and fit each other."""
    if lacking := sorted(_LAYOUT.keys() ^ arrays.keys()):
        raise ValueError(f"the array {lacking[0][:40]!r} is missing, or is none of a recording's")
    for name, (kind, axes) in _LAYOUT.items():
        array = arrays[name]
        if array.dtype.str.lstrip("<|")[: len(kind)] != kind or array.ndim != axes:
            raise ValueError(f"{name} is of type {array.dtype} with {array.ndim} axes, not {kind} with {axes}")
    n_frames, n_moving, n_parked = len(arrays["steps"]) + 1, len(arrays["first"]), len(arrays["parked"])
    n_vehicles = n_moving + n_parked
    if n_frames * max(n_vehicles, 1) > MAX_POSES:
        raise ValueError(f"{n_frames} frames of {n_vehicles} vehicles, of which at most {MAX_POSES} in all are read")
    n_connected = len(arrays["connected"])
    shapes = {
        "present": (-(-n_frames // 8), n_moving),
        "first": (n_moving, 3),
        "steps": (n_frames - 1, n_moving, 3),
        "parked": (n_parked, 3),
        "size": (n_vehicles, 3),
        "rsu": (min(len(arrays["rsu"]), 1) * 3,),
        "obstacles": (len(arrays["obstacles"]), 6),
    }
    for name, shape in shapes.items():
        if arrays[name].shape != shape:
            raise ValueError(f"{name} has shape {arrays[name].shape}, not {shape}")
    rows = arrays["connected"].tolist()
    if len(set(rows)) != n_connected or not all(0 <= row < n_vehicles for row in rows):
        raise ValueError(f"connected are not distinct rows of {n_vehicles} vehicles")
    if not 0 < float(arrays["dt"]) < np.inf:
        raise ValueError(f"dt must be a positive number of seconds, not {float(arrays['dt'])}")


def _unpack(arrays: dict[str, np.ndarray], name: str) -> Scene:
    first = arrays["first"]
    track = np.concatenate([first[None], arrays["steps"].astype(np.int64)]).cumsum(axis=0) * _POSE
    n_frames = len(track)
    track[np.unpackbits(arrays["present"], axis=0, count=n_frames) == 0] = np.nan
    parked = np.repeat((arrays["parked"] * _POSE)[None], n_frames, axis=0)
    pose = np.concatenate([track, parked], axis=1)
    pose[..., 2] = wrap(pose[..., 2])
    rsu = arrays["rsu"] * _LENGTH
    return Scene(
        name=name,
        kind=str(arrays["kind"]),
        dt=float(arrays["dt"]),
        pose=pose,
        size=arrays["size"] * _LENGTH,
        connected=arrays["connected"].astype(np.int64),
        rsu=rsu if len(rsu) else None,
        obstacles=arrays["obstacles"] * _BOX,
    )


def _hold(pose: Float[np.ndarray, "T M 3"], present: Bool[np.ndarray, "T M"]) -> Float[np.ndarray, "T M 3"]:
    """Absent entries filled with the last present one (before the first, with the first); yaw unwrapped."""
    seen = np.where(present, np.arange(len(pose))[:, None], -1)
    last: Int[np.ndarray, "T M"] = np.maximum.accumulate(seen, axis=0)
    last = np.where(last < 0, present.argmax(axis=0), last)
    held = np.take_along_axis(pose, last[..., None], axis=0)
    held[..., 2] = np.unwrap(held[..., 2], axis=0)
    return held


def wrap(angle: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """The same angle in [-pi, pi); rad."""
    return (angle + np.pi) % (2 * np.pi) - np.pi
