"""One scene of DAIR-V2X-C: boxes without numbers become vehicles, the ego finds its own, the road lies under all."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from cp_env.geometry import spatial
from cp_env.scenes.assembly.carrier import Track, under_sensor
from cp_env.scenes.assembly.road import DRAWN, levels_under, under_unit
from cp_env.scenes.assembly.tilt import foot
from cp_env.scenes.assembly.tracking import follow
from cp_env.scenes.dair_v2x.files import UNIT, VEHICLE, Labels, Pair, points_file
from cp_env.scenes.errors import BrokenData
from cp_env.scenes.opv2v.classes import Choice
from cp_env.types import Scene

FASTEST = 40.0  # m/s: so far a vehicle may be from where its last two places would have it
ALIKE = 1.0  # m by which a vehicle's drawn length and width may change from frame to frame
NEAR = 15.0  # m; so near a vehicle must be to tell the height of the road under the ego's LiDAR, if any ever is
SENSOR = 1.9  # m over the road: that of the ego's LiDAR if no vehicle is ever labelled
STRAY = 5.0  # m that offsets may move a unit by
MAST = 0.4  # m; side of the box in which a unit that is a second sender stands


@dataclass(frozen=True, eq=False)
class FrameSequence:
    """A scene, and what it takes to read its sweeps; agent 0 is the vehicle, agent 1 the unit."""

    scene: Scene
    kinds: tuple[str, ...]  # of the scene's vehicles
    files: tuple[tuple[Path, Path], ...]  # [frame][agent]
    world_T_sensor: Float[np.ndarray, "T 2 3 4"]
    place: Float[np.ndarray, "T 2 2"]  # from which points are given: the ego's middle, the mast; m
    level: Float[np.ndarray, "T 2"]  # z of the road under each sensor; m
    feet: Float[np.ndarray, "T M 3"]  # of the scene's vehicles; m
    boxes: Float[np.ndarray, "T M 7"]
    tilt: Float[np.ndarray, "T M 2"]


def pieces(times: Sequence[int], stride: int, lost: Collection[int] = ()) -> list[list[int]]:
    """The frames that follow each other at one rate: every `stride`-th, in pieces between holes.

    Args:
        times: of the frames, rising; µs.
        stride: every so many are kept.
        lost: places in `times` that cannot be read.
    """
    step = usual_step(times)
    found: list[list[int]] = []
    place, expected = 0, -1
    for k, time in enumerate(times):
        place += max(1, round((time - times[k - 1]) / step)) if k else 0
        if place % stride or k in lost:
            continue
        if place != expected:
            found.append([])
        found[-1].append(k)
        expected = place + stride
    return found


def usual_step(times: Sequence[int]) -> float:
    """µs from one frame to the next, the median; a tenth of a second if there is but one."""
    return float(np.median(np.diff(times))) if len(times) > 1 else 1e5


def build(
    root: Path,
    name: str,
    pairs: Sequence[Pair],
    labels: Sequence[Labels],
    world_T_sensor: Float[np.ndarray, "T 2 3 4"],
    choice: Choice,
    *,
    sender: bool,
) -> FrameSequence:
    """A scene out of its frames.

    Args:
        root: of the set.
        name: of the scene.
        pairs: its frames.
        labels: what is seen in each.
        world_T_sensor: of the vehicle's LiDAR and the unit's.
        choice: which objects count as vehicles.
        sender: the unit is the second connected vehicle; else the road-side unit.

    Raises:
        BrokenData: an object of an unknown class, or a unit that moves.
    """
    dt = float(np.median(np.diff([pair.time for pair in pairs]))) * 1e-6 if len(pairs) > 1 else 0.1
    tracks = _tracks(labels, FASTEST * dt)
    planar = np.concatenate([world_T_sensor[:, 0, :2, 3], spatial.heading(world_T_sensor[:, 0])[:, None]], axis=1)
    keys, ego = under_sensor(planar, tracks)
    others = {key: track for key, track in tracks.items() if key not in keys and _counts(root, choice, track, pairs)}
    every = [ego, *others.values()]
    boxes, tilt = np.stack([track.boxes() for track in every], axis=1), np.stack([one.tilt for one in every], axis=1)
    feet = np.concatenate([boxes[..., :2], np.stack([one.base for one in every], axis=1)[..., None]], axis=2)
    mast = _mast(root, pairs, world_T_sensor[:, 1, :2, 3])
    level = np.stack([_under_vehicle(world_T_sensor[:, 0, :, 3], feet), np.full(len(pairs), np.nan)], axis=1)
    lost = np.isnan(feet[:, 0, 2])
    feet[lost, 0, 2], boxes[lost, 0, 2] = level[lost, 0], level[lost, 0] + ego.extent[2]
    under = under_unit(feet, mast, DRAWN)
    level[:, 1] = under
    up = float(np.median(world_T_sensor[:, 1, 2, 3])) - under
    kinds = [track.kind or "vehicle" for track in every]
    if sender:
        pole = np.array([*mast, under + up / 2, MAST, MAST, max(up, MAST), 0.0])
        boxes = np.insert(boxes, 1, pole, axis=1)
        tilt, feet = np.insert(tilt, 1, 0.0, axis=1), np.insert(feet, 1, np.nan, axis=1)
        kinds.insert(1, "unit")
    place = np.stack([boxes[:, 0, :2], np.broadcast_to(mast, (len(pairs), 2))], axis=1)
    scene = Scene(
        name=name,
        kind="intersection",
        dt=dt,
        pose=boxes[..., [0, 1, 6]],
        size=np.nanmedian(boxes[..., 3:6], axis=0),
        connected=np.arange(1 + sender),
        rsu=None if sender else np.array([*mast, up]),
        obstacles=np.zeros((0, 6)),
    )
    files = tuple((points_file(root, VEHICLE, pair.vehicle), points_file(root, UNIT, pair.unit)) for pair in pairs)
    return FrameSequence(scene, tuple(kinds), files, world_T_sensor, place, level, feet, boxes, tilt)


def _tracks(labels: Sequence[Labels], reach: float) -> dict[int, Track]:
    """Every object followed from frame to frame, of its median size; its class is that of most of its frames."""
    flat = [there.boxes[:, [0, 1, 3, 4, 6]] for there in labels]
    tracks: dict[int, Track] = {}
    for number, met in enumerate(follow(flat, reach=reach, alike=ALIKE)):
        size = np.median([labels[t].boxes[b, 3:6] for t, b in met.items()], axis=0)
        kinds = [labels[t].kinds[b] for t, b in met.items()]
        track = tracks[number] = Track.blank(
            len(labels), np.zeros(3), size / 2, max(sorted(set(kinds)), key=kinds.count)
        )
        for t, b in met.items():
            box, lean = labels[t].boxes[b], labels[t].tilt[b]
            track.pose[t], track.z[t], track.tilt[t] = box[[0, 1, 6]], box[2], lean
            track.base[t] = foot(box, lean)
    return tracks


def _counts(root: Path, choice: Choice, track: Track, pairs: Sequence[Pair]) -> bool:
    """Whether an object is a vehicle; BrokenData with the first file that names an unknown class."""
    try:
        return choice.counts(track.kind)
    except ValueError as error:
        t = int(np.flatnonzero(np.isfinite(track.base))[0])
        raise BrokenData(root / "cooperative" / "label_world" / f"{pairs[t].vehicle}.json", str(error)) from error


def _under_vehicle(sensor: Float[np.ndarray, "T 3"], feet: Float[np.ndarray, "T M 3"]) -> Float[np.ndarray, " T"]:
    """z of the road under the vehicle's LiDAR, which stands at one height over it: the median over vehicles near it."""
    levels = levels_under(feet, sensor[:, :2], DRAWN)
    away = np.hypot(*np.moveaxis(feet[..., :2] - sensor[:, None, :2], -1, 0))
    away = np.where(np.isnan(feet[..., 2]), np.inf, away).min(axis=1)
    height = sensor[:, 2] - levels
    close = away < NEAR
    known = height[close if close.any() else np.isfinite(height)]
    return np.asarray(sensor[:, 2] - (np.median(known) if len(known) else SENSOR))


def _mast(root: Path, pairs: Sequence[Pair], places: Float[np.ndarray, "T 2"]) -> Float[np.ndarray, " 2"]:
    """Where the unit stands: the median of its places, which offsets of pairs move by little; m."""
    mast = np.median(places, axis=0)
    stray = np.hypot(*(places - mast).T)
    if stray.max() > STRAY:
        file = root / UNIT / "calib" / "virtuallidar_to_world" / f"{pairs[int(stray.argmax())].unit}.json"
        raise BrokenData(file, f"the unit is {stray.max():.1f} m from where it mostly stands; it does not move")
    return np.asarray(mast)
