"""The file of one recorded scene: compressed numpy arrays of small integers, nothing pickled.

Convention:
    Lengths are stored in centimetres, angles in milliradians. Moving vehicles are stored as differences from frame to
    frame (an absent vehicle keeps its last place and is masked), vehicles that stand for the whole scene only once.
    Rows of a `Scene` read back: the moving vehicles, then the parked ones.
"""

from __future__ import annotations

import zipfile
import zlib
from io import BytesIO
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int

from cp_env.types import Scene

VERSION = 1
_LENGTH, _ANGLE = 0.01, 0.001
_POSE = np.array([_LENGTH, _LENGTH, _ANGLE])
_BOX = np.array([_LENGTH, _LENGTH, _ANGLE, _LENGTH, _LENGTH, _LENGTH])


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
        ValueError: the file is missing, broken, or of another version; the message names it.
    """
    data = content(path, name)
    try:
        with np.load(BytesIO(data), allow_pickle=False) as file:
            arrays = {key: file[key] for key in file.files}
        if int(arrays["version"]) != VERSION:
            raise ValueError(f"version {int(arrays['version'])}, this program reads {VERSION}")
        return _unpack(arrays, name)
    except (ValueError, KeyError, IndexError, TypeError, OSError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise ValueError(f"recording {path} is broken ({error}); reinstall or record it again") from error


def content(path: Path, name: str) -> bytes:
    """The bytes of the recording of scene `name`.

    Raises:
        ValueError: `path` cannot be read.
    """
    try:
        return path.read_bytes()
    except OSError as error:
        raise ValueError(f"scene {name!r} needs the recording {path}: {error}; reinstall or record it again") from error


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
