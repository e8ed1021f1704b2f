"""The files of OPV2V's layout: what one agent's YAML says of one frame, and its points."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Float32

from cp_env.geometry import spatial
from cp_env.scenes.errors import BrokenData
from cp_env.scenes.formats import pcd
from cp_env.scenes.formats.bounded import read_bytes
from cp_env.scenes.opv2v import bounded_yaml
from cp_env.scenes.opv2v.axes import carla_motion, from_carla, mirrored
from cp_env.scenes.opv2v.layouts import OPV2V, V2V4REAL, Layout

LISTED = ("location", "angle", "center", "extent")
RIGID = 1e-3  # how far a pose's matrix may be from a rotation: files hold a few digits
_BLOCK = re.compile(r"^(?![ \t#-]).*\n?(?:[ \t#-].*\n?|\n)*", re.MULTILINE)  # a key of the file and all that it holds
_KEPT = re.compile(r"(?:lidar_pose|true_ego_pose?|predicted_ego_pose?|ego_speed|timestamp|vehicles)\s*:")
_ALIAS, _ANCHOR = (re.compile(rf"(?<![\w'\"]){sign}(\w+)") for sign in (r"\*", "&"))


@dataclass(frozen=True, eq=False)
class Note:
    """What one agent's file says of one frame, in our axes; m, rad. V is the number of objects it lists."""

    lidar: Float[np.ndarray, "3 4"]  # world_T_lidar
    body: Float[np.ndarray, "3 4"] | None  # of the agent's own origin
    predicted: Float[np.ndarray, "3 4"] | None  # the same, as it believed
    speed: float  # the agent's own, in the file's unit; NaN if not given
    timestamp: float | None  # in the file's unit
    numbers: tuple[int, ...]  # of the objects
    associated: tuple[int | None, ...]  # V2V4Real: the number by which the agents know it together
    kinds: tuple[str | None, ...]  # obj_type
    speeds: Float[np.ndarray, " V"]  # NaN where not given
    pose: Float[np.ndarray, "V 3 4"]  # world_T_object, of its origin
    center: Float[np.ndarray, "V 3"]  # of its box, from the origin along its own axes
    extent: Float[np.ndarray, "V 3"]  # half of length, width, height
    widest: float  # the largest angle of an object, in the file's unit


def read_note(path: Path, layout: Layout = OPV2V, *, radians: bool = False) -> Note:
    """One agent's file of one frame.

    Args:
        path: the YAML file.
        layout: how to understand it.
        radians: whether the angles of objects are given in rad, else in degrees.

    Returns:
        What it says.

    Raises:
        BrokenData: it is missing, no YAML or one beyond `bounded_yaml`'s bounds, lacks something, or holds a number
            that is none.
        ImportError: PyYAML is not installed.
    """
    try:
        text = read_bytes(path, bounded_yaml.MAX_BYTES).decode("utf-8")
        said = bounded_yaml.load(_kept(text))
        return _note(said if isinstance(said, dict) else {}, layout, radians)
    except OSError as error:
        raise BrokenData(path, f"cannot be read: {error.strerror}") from error
    except (ValueError, TypeError, KeyError, OverflowError) as error:
        raise BrokenData(path, str(error).strip("'\"")) from error


def read_points(path: Path) -> Float32[np.ndarray, "P 3"]:
    """The points of one sweep in the frame of the file; m.

    Args:
        path: a `.pcd`, or a `.bin` of x, y, z and intensity in single precision (V2X-Real).

    Raises:
        BrokenData: the file is missing, cut short, too large, or holds no points.
    """
    points = _bin(path) if path.suffix == ".bin" else pcd.read(path)
    if not len(points):
        raise BrokenData(path, "holds no points")
    return points


def _bin(path: Path) -> Float32[np.ndarray, "P 3"]:
    try:
        content = read_bytes(path, pcd.FILE_BYTES)
    except (OSError, ValueError) as error:
        raise BrokenData(path, f"cannot be read: {error.strerror if isinstance(error, OSError) else error}") from error
    if len(content) % 16:
        raise BrokenData(path, f"is cut short: {len(content)} bytes are no whole number of points of 16 bytes")
    rows = np.frombuffer(content, "<f4").reshape(-1, 4)[:, :3]
    finite = np.isfinite(rows).all(axis=1)
    return np.ascontiguousarray(rows if finite.all() else rows[finite])


def _kept(text: str) -> str:
    """The part of a file that is needed: cameras and plans take longer to parse than all the rest.

    What the part repeats by an alias is kept wherever it is named.
    """
    blocks: list[str] = _BLOCK.findall(text)
    wanted = [k for k, block in enumerate(blocks) if _KEPT.match(block)]
    if "*" in text and "&" in text:
        named: dict[str, list[int]] = {}
        for k, block in enumerate(blocks):
            for anchor in _ANCHOR.findall(block):
                named.setdefault(anchor, []).append(k)
        for k in wanted:  # it grows by what it names
            wanted += [m for alias in _ALIAS.findall(blocks[k]) for m in named.pop(alias, ())]
    return "".join(blocks[k] for k in sorted(set(wanted))) or text


def _note(said: dict[str, Any], layout: Layout, radians: bool) -> Note:
    if "lidar_pose" not in said:
        raise KeyError("lacks lidar_pose")
    lidar = _pose(said, "lidar_pose", layout)
    body, predicted = (
        next((_pose(said, key, layout) for key in (name, name + "e") if said.get(key) is not None), None)
        for name in ("true_ego_pos", "predicted_ego_pos")
    )
    table = said.get("vehicles") or {}
    if not isinstance(table, dict):
        raise ValueError(f"vehicles must be a table by number: got {table!s:.80}")
    location, angle, center, extent = np.moveaxis(_listed(table), 1, 0)
    pose = np.concatenate([location, np.rad2deg(angle) if radians else angle], axis=1)
    world_T_object = carla_motion(pose) if layout.right_handed else from_carla(pose)
    if layout.local_boxes:
        world_T_object = spatial.chain(np.broadcast_to(lidar, world_T_object.shape), world_T_object)
    entries = list(table.values())
    return Note(
        lidar=lidar,
        body=body,
        predicted=predicted,
        speed=_maybe(said.get("ego_speed"), np.nan),
        timestamp=_maybe(said.get("timestamp"), None),
        numbers=tuple(_number(number) for number in table),
        associated=tuple(_associated(entry.get("ass_id")) for entry in entries),
        kinds=tuple(None if entry.get("obj_type") is None else str(entry["obj_type"]) for entry in entries),
        speeds=np.array([_maybe(entry.get("speed"), np.nan) for entry in entries], dtype=np.float64),
        pose=world_T_object,
        center=center if layout.right_handed else mirrored(center),
        extent=extent,
        widest=float(np.abs(angle).max(initial=0.0)),
    )


def _listed(table: dict[Any, Any]) -> Float[np.ndarray, "V 4 3"]:
    """Location, angle, center and extent of all objects."""
    for number, entry in table.items():
        if not isinstance(entry, dict):
            raise ValueError(f"vehicle {number} is {str(entry)[:80]!r}, not a table")
    try:
        listed = np.array([[entry[key] for key in LISTED] for entry in table.values()], dtype=np.float64)
        good = listed.shape == (len(table), 4, 3) and bool(np.isfinite(listed).all() and (listed[:, 3] > 0).all())
    except (KeyError, ValueError, TypeError, OverflowError):
        good = False
    if good:
        return listed
    if not table:
        return np.zeros((0, 4, 3))
    for number, entry in table.items():
        *_, extent = [_numbers(entry, key, (3,), f"vehicle {number}: ") for key in LISTED]
        if (extent <= 0).any():
            raise ValueError(f"vehicle {number}: extent {extent.tolist()} is not positive")
    raise ValueError("vehicles cannot be read as numbers")


def _pose(said: dict[str, Any], key: str, layout: Layout) -> Float[np.ndarray, "3 4"]:
    """world_T_body of a pose of six numbers, or of a 4 × 4 matrix where there may be one."""
    if not layout.right_handed:
        if np.shape(said[key])[:1] == (4,):
            raise ValueError(
                f"{key} is a matrix, as in V2V4Real: open the data as {V2V4REAL.kind}:PATH, not as {layout.kind}:PATH"
            )
        return from_carla(_numbers(said, key, (6,)))
    if np.shape(said[key])[:1] != (4,):
        return carla_motion(_numbers(said, key, (6,)))
    matrix = _numbers(said, key, (4, 4))
    turn = matrix[:3, :3]
    if (
        np.abs(matrix[3] - [0, 0, 0, 1]).max() > RIGID
        or np.abs(turn @ turn.T - np.eye(3)).max() > RIGID
        or np.linalg.det(turn) < 0
    ):
        raise ValueError(f"{key} is no rigid motion: its matrix must be [R t; 0 0 0 1] with a right-handed rotation R")
    return matrix[:3]


def _numbers(table: dict[str, Any], key: str, shape: tuple[int, ...], where: str = "") -> Float[np.ndarray, "..."]:
    if key not in table:
        raise KeyError(f"{where}lacks {key}")
    try:
        numbers = np.array(table[key], dtype=np.float64)
    except (ValueError, TypeError, OverflowError) as error:
        raise ValueError(f"{where}{key}: {str(error)[:80]}") from error
    if numbers.shape != shape or not np.isfinite(numbers).all():
        count = " × ".join(map(str, shape))
        raise ValueError(f"{where}{key} must be {count} finite numbers: got {table[key]!s:.80}")
    return numbers


def _number(key: Any) -> int:
    if isinstance(key, bool) or not isinstance(key, int | str) or not re.fullmatch(r"-?\d{1,18}", str(key)):
        raise ValueError(f"vehicle {str(key)[:40]!r} is named by no whole number")
    return int(key)


def _associated(value: Any) -> int | None:
    """V2V4Real's `ass_id`, -1 if the agents know no common number."""
    return None if value is None or value == -1 else _number(value)


def _maybe(value: Any, absent: Any) -> Any:
    """A finite number, or `absent`: what a file need not say is not held against it."""
    if isinstance(value, bool) or not isinstance(value, int | float) or abs(value) > 1e25:
        return absent
    return float(value) if np.isfinite(value) else absent
