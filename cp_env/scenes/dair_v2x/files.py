"""The files of DAIR-V2X-C: which frames belong together, calibrations, labels.

Layout, of the folder `cooperative-vehicle-infrastructure`; `<n>` is a frame's number, counted by each side for itself:

    cooperative/data_info.json                            pairs of frames, and the offset of a pair
    cooperative/label_world/<n>.json                      boxes in the world, by the vehicle's number
    vehicle-side/data_info.json                           batch and time of each frame
    vehicle-side/calib/{lidar_to_novatel,novatel_to_world}/<n>.json
    infrastructure-side/calib/virtuallidar_to_world/<n>.json
    {vehicle-side,infrastructure-side}/velodyne/<n>.pcd   points
Source: the data set's own documentation and toolkit (github.com/AIR-THU/DAIR-V2X), read for their conventions.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from jaxtyping import Float

from cp_env.geometry import spatial
from cp_env.scenes.assembly.tilt import attitude
from cp_env.scenes.errors import BrokenData
from cp_env.scenes.formats.bounded import parse_json, read_bytes

INFO_BYTES = 64 << 20
"""A `data_info.json` is at most so long; the largest of the set is about 16 MB."""

FILE_BYTES = 4 << 20
"""A calibration or a frame's labels are at most so long; they take kilobytes."""

NEARLY = 0.05  # how far a calibration may be from a rotation: some were made without that constraint
BENT = 0.1  # m, or a tenth of its longest side if that is more: how far eight corners may be from a box's
LEAST = 0.01  # m; what is thinner is no box
INNER = "cooperative-vehicle-infrastructure"
VEHICLE, UNIT = "vehicle-side", "infrastructure-side"


@dataclass(frozen=True)
class Pair:
    """A frame of the vehicle and the unit's that belongs to it."""

    vehicle: str  # its number, as written: "000010"
    unit: str
    batch: str
    time: int  # of the vehicle's points; µs
    offset: tuple[float, float] | None  # what is to be added to the unit's place; m, None if not given


@dataclass(frozen=True, eq=False)
class Labels:
    """The objects of one frame, in the world."""

    kinds: tuple[str, ...]
    boxes: Float[np.ndarray, "L 7"]  # x, y, z of the middle, length, width, height, yaw; m, rad
    tilt: Float[np.ndarray, "L 2"]  # roll and pitch; rad


def find_root(path: Path) -> Path:
    """The folder that holds `cooperative`: `path`, or the one in it that the set is handed out in.

    Raises:
        BrokenData: there is none.
    """
    for root in (path, path / INNER):
        if (root / "cooperative" / "data_info.json").is_file():
            return root
    raise BrokenData(path, f"holds no cooperative/data_info.json; point to the folder {INNER} of DAIR-V2X-C")


def points_file(root: Path, side: str, number: str) -> Path:
    """The points of one frame of one side."""
    return root / side / "velodyne" / f"{number}.pcd"


def files_of(root: Path, pair: Pair) -> tuple[Path, ...]:
    """All that is read of a pair."""
    return (
        points_file(root, VEHICLE, pair.vehicle),
        points_file(root, UNIT, pair.unit),
        root / VEHICLE / "calib" / "lidar_to_novatel" / f"{pair.vehicle}.json",
        root / VEHICLE / "calib" / "novatel_to_world" / f"{pair.vehicle}.json",
        root / UNIT / "calib" / "virtuallidar_to_world" / f"{pair.unit}.json",
        root / "cooperative" / "label_world" / f"{pair.vehicle}.json",
    )


def read_pairs(root: Path) -> tuple[Pair, ...]:
    """Every pair of the set, in the order of its file.

    Raises:
        BrokenData: a file is missing, no list of records, or a record lacks something.
    """
    file, sides = root / "cooperative" / "data_info.json", root / VEHICLE / "data_info.json"
    when: dict[str, tuple[str, int]] = {}
    for k, record in enumerate(_records(sides)):
        with _Record(sides, k):
            stamp = int(str(record["pointcloud_timestamp"])[:19])
            when[_number(record["pointcloud_path"])] = str(record["batch_id"])[:40], stamp
    pairs = []
    for k, record in enumerate(_records(file)):
        if "vehicle_frame" in record and "vehicle_pointcloud_path" not in record:
            raise BrokenData(
                file, "is V2X-Seq's (vehicle_frame in place of paths), which is not read: docs/dair-v2x.md"
            )
        with _Record(file, k):
            vehicle, unit = (
                _number(record["vehicle_pointcloud_path"]),
                _number(record["infrastructure_pointcloud_path"]),
            )
            if vehicle not in when:
                raise ValueError(f"it names the vehicle's frame {vehicle}, of which {sides} says nothing")
            pairs.append(Pair(vehicle, unit, *when[vehicle], _offset(record.get("system_error_offset"))))
    if not pairs:
        raise BrokenData(file, "holds no pair of frames")
    return tuple(pairs)


def vehicle_pose(root: Path, pair: Pair) -> Float[np.ndarray, "3 4"]:
    """world_T_lidar of the vehicle: from its LiDAR to its receiver (NovAtel), from there to the world."""
    _, _, lidar, novatel, _, _ = files_of(root, pair)
    world_T_novatel, novatel_T_lidar = _motion(novatel, _object(novatel)), _motion(lidar, _object(lidar))
    return spatial.chain(world_T_novatel, novatel_T_lidar)


def unit_pose(root: Path, pair: Pair, *, offset: bool) -> Float[np.ndarray, "3 4"]:
    """world_T_lidar of the unit's virtual LiDAR.

    Args:
        root: of the set.
        pair: of frames.
        offset: whether its place is mended: by the pair's offset, or by the calibration's `relative_error` where the
            pair gives none.
    """
    file = files_of(root, pair)[4]
    said = _object(file)
    pose = _motion(file, said)
    if offset:
        with _Record(file, None):
            shift = pair.offset if pair.offset is not None else _offset(said.get("relative_error"))
        pose[:2, 3] += shift or (0.0, 0.0)
    return pose


def read_labels(root: Path, pair: Pair) -> Labels:
    """The objects of a pair, by their corners: all else in the file is of no world.

    Corners 0 to 3 are the floor's, 4 to 7 those above them; 0 and 1 are in front, 1 and 2 to the right.

    Raises:
        BrokenData: the file is missing, an object has no eight corners, or they are no box's.
    """
    file = files_of(root, pair)[5]
    kinds, poses, sizes = [], [], []
    for k, record in enumerate(_records(file)):
        with _Record(file, k):
            kind, corners = str(record["type"])[:40], np.array(record["world_8_points"], dtype=np.float64)
            if corners.shape != (8, 3) or not np.isfinite(corners).all():
                raise ValueError("world_8_points must be eight points of three finite numbers")
            pose, size = _box(corners)
            if size.min() >= LEAST:
                kinds.append(kind)
                poses.append(pose)
                sizes.append(size)
    world_T_box, extent = np.array(poses).reshape(-1, 3, 4), np.array(sizes).reshape(-1, 3)
    yaw, *tilt = attitude(world_T_box[..., :3]).T
    boxes = np.concatenate([world_T_box[..., 3], extent, yaw[:, None]], axis=1)
    return Labels(tuple(kinds), boxes, np.stack(tilt, axis=1))


def _box(corners: Float[np.ndarray, "8 3"]) -> tuple[Float[np.ndarray, "3 4"], Float[np.ndarray, " 3"]]:
    """world_T_box of a box's middle, and its length, width and height; m."""
    middle = corners.mean(axis=0)
    ahead = corners[[0, 1, 4, 5]].mean(axis=0) - middle
    left = corners[[0, 3, 4, 7]].mean(axis=0) - middle
    up = corners[4:].mean(axis=0) - middle
    axes = np.stack([ahead, left, up], axis=1)
    half = np.linalg.norm(axes, axis=0)
    if half.min() < LEAST / 2:
        return np.column_stack([np.eye(3), middle]), 2 * half
    turn, _ = _rotation(axes / half)
    signs = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]])
    made = np.concatenate([np.column_stack([signs, np.full(4, z)]) for z in (-1, 1)]) * half
    if turn[2, 2] < 0.5 or np.abs(made @ turn.T + middle - corners).max() > max(BENT, 0.2 * half.max()):
        raise ValueError("world_8_points are no corners of a box: floor first, front left, front right, back right, …")
    return np.column_stack([turn, middle]), 2 * half


def _rotation(matrix: Float[np.ndarray, "3 3"]) -> tuple[Float[np.ndarray, "3 3"], float]:
    """The nearest rotation, and how far it is."""
    u, _, v = np.linalg.svd(matrix)
    turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v
    return turn, float(np.abs(turn - matrix).max())


def _motion(file: Path, said: dict[str, Any]) -> Float[np.ndarray, "3 4"]:
    """a_T_b of a calibration: `rotation` and `translation`, in `transform` or not."""
    with _Record(file, None):
        said = said.get("transform", said)
        matrix, shift = (np.array(said[key], dtype=np.float64) for key in ("rotation", "translation"))
        if matrix.shape != (3, 3) or shift.size != 3 or not (np.isfinite(matrix).all() and np.isfinite(shift).all()):
            raise ValueError("rotation and translation must be 3 × 3 and three finite numbers")
        turn, away = _rotation(matrix)
        if away > NEARLY:
            raise ValueError(f"rotation is no right-handed rotation: it is {away:.2f} from the nearest one")
        return np.column_stack([turn, shift.reshape(3)])


def _offset(said: Any) -> tuple[float, float] | None:
    """delta_x and delta_y; an empty text is 0 there, and in place of both that there is none."""
    if not isinstance(said, dict):
        if said in (None, ""):
            return None
        raise ValueError(f"an offset must be a table of delta_x and delta_y, not {said!r:.40}")
    x, y = (float(said.get(key) or 0) for key in ("delta_x", "delta_y"))
    if not np.isfinite((x, y)).all():
        raise ValueError("delta_x and delta_y must be finite")
    return x, y


def _number(path: Any) -> str:
    stem = PurePosixPath(str(path)[-200:]).stem
    if not re.fullmatch(r"\d{1,12}", stem):
        raise ValueError(f"{str(path)[:80]!r} names no frame by its number")
    return stem


def _records(file: Path) -> list[dict[str, Any]]:
    said = _json(file, INFO_BYTES if file.name == "data_info.json" else FILE_BYTES)
    if not isinstance(said, list) or not all(isinstance(record, dict) for record in said):
        raise BrokenData(file, "must hold a JSON list of records")
    return said


def _object(file: Path) -> dict[str, Any]:
    said = _json(file, FILE_BYTES)
    if not isinstance(said, dict) or not isinstance(said.get("transform", {}), dict):
        raise BrokenData(file, "must hold a JSON object")
    return said


def _json(file: Path, limit: int) -> Any:
    try:
        return parse_json(read_bytes(file, limit), limit=limit)
    except OSError as error:
        raise BrokenData(file, f"cannot be read: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise BrokenData(file, f"is no JSON that can be read: {str(error)[:200]}") from error


class _Record:
    """Turns what is wrong with a record of a file into BrokenData."""

    def __init__(self, file: Path, number: int | None) -> None:
        self._file, self._where = file, "" if number is None else f"record {number}: "

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: object) -> None:
        if isinstance(error, KeyError):
            raise BrokenData(self._file, f"{self._where}lacks {str(error)[:80]}") from error
        if isinstance(error, ValueError | TypeError | OverflowError) and not isinstance(error, BrokenData):
            raise BrokenData(self._file, f"{self._where}{str(error)[:300]}") from error
