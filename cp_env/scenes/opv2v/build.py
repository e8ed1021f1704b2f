"""A scene out of what its agents' files say: tracks of all vehicles, who carries which sensor, the road under them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from cp_env.geometry.planar import compose, invert
from cp_env.scenes.assembly.carrier import UNSEEN, Track, under_sensor
from cp_env.scenes.assembly.road import DRAWN, EXACT, under_unit
from cp_env.scenes.errors import BrokenData
from cp_env.scenes.opv2v.axes import planar
from cp_env.scenes.opv2v.classes import Choice
from cp_env.scenes.opv2v.files import Note
from cp_env.scenes.opv2v.folders import Scenario
from cp_env.scenes.opv2v.layouts import Layout
from cp_env.types import Scene

SENSOR = 1.9  # m above the road: that of a connected vehicle near which no vehicle is ever listed
NEAR = 15.0  # m; so near a vehicle must be to tell the height of the road under a sensor, if any ever is

Key = tuple[int, int]  # who numbers it (0 if all do together), and its number
Notes = Sequence[Sequence[Note]]  # [frame][agent]


@dataclass(frozen=True, eq=False)
class FrameSequence:
    """A scene, and what it takes to read its sweeps; agents are its connected vehicles, then its road-side unit."""

    scene: Scene
    kinds: tuple[str, ...]  # of the scene's vehicles: their `obj_type`, "vehicle" where none is given
    files: tuple[tuple[Path, ...], ...]  # [frame][agent]
    world_T_lidar: Float[np.ndarray, "T A 3 4"]
    ground: Float[np.ndarray, "T A"]  # height of the road under each sensor; m
    feet: Float[np.ndarray, "T M 3"]  # of the scene's vehicles, in the world; m
    boxes: Float[np.ndarray, "T M 7"]  # x, y, z of the middle, length, width, height, yaw; m, rad
    tilt: Float[np.ndarray, "T M 2"]  # roll and pitch of the boxes; rad
    believed: Float[np.ndarray, "T A 3"]  # where the ego takes the agent to be; m, m, rad
    place: Float[np.ndarray, "T A 3"]  # where it is: box centre of a vehicle, sensor of a unit


def build(
    scenario: Scenario, numbers: Sequence[str], notes: Notes, layout: Layout, choice: Choice, dt: float, name: str
) -> FrameSequence:
    """The scene and its sensors, all poses believed as they are.

    Args:
        scenario: its agents.
        numbers: of its frames.
        notes: what each agent says of each.
        layout: how its files name vehicles.
        choice: which objects count as vehicles; connected ones always do.
        dt: s between frames.
        name: of the scene.

    Raises:
        BrokenData: an object of an unknown class, a connected vehicle that is nowhere, or a road-side unit that moves.
    """
    world_T_lidar = np.array([[note.lidar for note in row] for row in notes])
    tracks = _tracks(scenario, numbers, notes, layout)
    own = _carried(scenario, numbers, notes, layout, tracks)
    gone = {key for keys, _ in own for key in keys}
    for key, track in tracks.items():
        try:
            if not choice.counts(track.kind):
                gone.add(key)
        except ValueError as error:
            raise BrokenData(_first_file(scenario, numbers, notes, track.kind), f"vehicle {key[1]}: {error}") from error
    every = [track for _, track in own] + [track for key, track in sorted(tracks.items()) if key not in gone]
    pose = np.stack([track.pose for track in every], axis=1)
    base = np.stack([track.base for track in every], axis=1)
    ground = _ground(scenario, world_T_lidar, base, pose, layout)
    boxes = np.stack([track.boxes() for track in every], axis=1)
    _stand(boxes, base, ground[:, : len(own)])
    place = np.concatenate([pose[:, : len(own)], _unit(scenario, numbers, world_T_lidar)], axis=1)
    mast = None if scenario.rsu is None else world_T_lidar[0, -1, :, 3] - [0.0, 0.0, ground[0, -1]]
    scene = Scene(
        name=name,
        kind="recorded",
        dt=dt,
        pose=pose,
        size=np.array([2 * track.extent for track in every]),
        connected=np.arange(len(own)),
        rsu=mast,
        obstacles=np.zeros((0, 6)),
    )
    kinds = tuple(track.kind or "vehicle" for track in every)
    files = tuple(tuple(scenario.points(agent, number) for agent in scenario.agents) for number in numbers)
    feet = np.concatenate([pose[..., :2], base[..., None]], axis=2)
    tilt = np.stack([track.tilt for track in every], axis=1)
    return FrameSequence(scene, kinds, files, world_T_lidar, ground, feet, boxes, tilt, place, place)


def localised(
    scenario: Scenario, numbers: Sequence[str], notes: Notes, place: Float[np.ndarray, "T A 3"]
) -> Float[np.ndarray, "T A 3"]:
    """Where the recorded localisation of the ego and of each agent together put the agent; m, m, rad.

    Raises:
        BrokenData: a file does not give it.
    """
    taken = np.empty_like(place)
    for t, row in enumerate(notes):
        poses = []
        for agent, note in zip(scenario.agents, row, strict=True):
            if note.body is None or note.predicted is None:
                raise BrokenData(
                    scenario.note(agent, numbers[t]), "lacks true_ego_pos and predicted_ego_pos; use poses=true"
                )
            poses.append([planar(note.body), planar(note.predicted)])
        true, predicted = np.array(poses).swapaxes(0, 1)
        here = compose(invert(true), place[t])  # the box in the body's frame
        ego = compose(true[0], invert(predicted[0]))
        taken[t] = compose(np.broadcast_to(ego, predicted.shape), compose(predicted, here))
    return taken


def _objects(scenario: Scenario, notes: Notes, layout: Layout) -> Iterator[tuple[int, Key, Note, int]]:
    """Every object listed: frame, key, note and its row there; what the first agent says comes first."""
    for t, row in enumerate(notes):
        for agent, note in zip(scenario.agents, row, strict=True):
            for k, number in enumerate(note.numbers):
                if not layout.local_boxes:
                    yield t, (0, number), note, k
                elif note.associated[k] is not None:
                    yield t, (0, int(note.associated[k] or 0)), note, k
                else:
                    yield t, (int(agent), number), note, k


def _tracks(scenario: Scenario, numbers: Sequence[str], notes: Notes, layout: Layout) -> dict[Key, Track]:
    """The track of every object, as the first agent that lists it in a frame has it there."""
    tracks: dict[Key, Track] = {}
    for t, key, note, k in _objects(scenario, notes, layout):
        if key not in tracks:
            tracks[key] = Track.blank(len(numbers), note.center[k], note.extent[k], note.kinds[k])
        track = tracks[key]
        if not np.isnan(track.base[t]):
            continue
        track.put(t, note.pose[k], note.center[k], note.pose[k][2, 3])
        if not layout.on_ground:
            track.base[t] = track.z[t] - note.extent[k, 2]
    return tracks


def _carried(
    scenario: Scenario, numbers: Sequence[str], notes: Notes, layout: Layout, tracks: dict[Key, Track]
) -> list[tuple[set[Key], Track]]:
    """Of each connected vehicle the keys under which it is listed, and its track, without gaps."""
    found = []
    for k, agent in enumerate(scenario.vehicles):
        own = [row[k] for row in notes]
        if layout.agents_are_vehicles:
            key = (0, int(agent))
            track = tracks.get(key)
            found.append(({key}, _by_body(scenario, agent, numbers, own, track)))
        else:
            found.append(under_sensor(planar(np.array([note.lidar for note in own])), tracks))
    return found


def _by_body(
    scenario: Scenario, agent: str, numbers: Sequence[str], own: Sequence[Note], listed: Track | None
) -> Track:
    """A connected vehicle; in frames where no agent lists it, it stands where its own file says."""
    track = Track.blank(len(own), *UNSEEN, None) if listed is None else listed.copy()
    for t in np.flatnonzero(np.isnan(track.base)).tolist():
        body = own[t].body
        if body is None:
            raise BrokenData(scenario.note(agent, numbers[t]), "lacks true_ego_pos, no other agent lists it")
        track.put(t, body, track.center, body[2, 3])
    return track


def _ground(
    scenario: Scenario,
    world_T_lidar: Float[np.ndarray, "T A 3 4"],
    base: Float[np.ndarray, "T M"],
    pose: Float[np.ndarray, "T M 3"],
    layout: Layout,
) -> Float[np.ndarray, "T A"]:
    """Height of the road under each sensor: that under the vehicle next to it; m.

    In real recordings a sensor stands at one height over the road, the median of those over vehicles near it: boxes
    there are drawn by hand.
    """
    gap = np.linalg.norm(pose[:, None, :, :2] - world_T_lidar[:, :, None, :2, 3], axis=-1)
    gap = np.where(np.isnan(base)[:, None], np.inf, gap)
    nearest = gap.argmin(axis=2)
    least = np.take_along_axis(gap, nearest[..., None], axis=2)[..., 0]
    ground = np.where(np.isfinite(least), np.take_along_axis(base, nearest, axis=1), np.nan)
    if not layout.on_ground:
        for agent in range(ground.shape[1]):
            z = world_T_lidar[:, agent, 2, 3]
            height = z - ground[:, agent]
            close = least[:, agent] < NEAR
            height = height[close if close.any() else np.isfinite(height)]
            ground[:, agent] = z - (np.median(height) if len(height) else SENSOR)
    if scenario.rsu is not None:  # it stands still, whoever drives by
        feet = np.concatenate([pose[..., :2], base[..., None]], axis=2)
        level = under_unit(feet, world_T_lidar[0, -1, :2, 3], EXACT if layout.on_ground else DRAWN)
        ground[:, -1] = np.median(ground[:, -1]) if np.isnan(level) else level
    return ground


def _stand(boxes: Float[np.ndarray, "T M 7"], base: Float[np.ndarray, "T M"], ground: Float[np.ndarray, "T C"]) -> None:
    """Put the boxes of carriers, which come first, on the road in frames where none is listed there."""
    own = slice(0, ground.shape[1])
    lost = np.isnan(base[:, own])
    base[:, own][lost] = ground[lost]
    boxes[:, own, 2][lost] = (ground + boxes[:, own, 5] / 2)[lost]


def _unit(
    scenario: Scenario, numbers: Sequence[str], world_T_lidar: Float[np.ndarray, "T A 3 4"]
) -> Float[np.ndarray, "T _ 3"]:
    """Place and heading of the road-side unit's sensor, one column; none without it."""
    if scenario.rsu is None:
        return np.zeros((len(world_T_lidar), 0, 3))
    sensor = world_T_lidar[:, -1]
    stray = np.linalg.norm(sensor[:, :, 3] - sensor[0, :, 3], axis=1)
    if stray.max() > 0.01:
        file = scenario.note(scenario.rsu, numbers[int(stray.argmax())])
        raise BrokenData(file, f"the road-side unit's lidar_pose is {stray.max():.2f} m from its first one")
    return planar(sensor)[:, None]


def _first_file(scenario: Scenario, numbers: Sequence[str], notes: Notes, kind: str | None) -> Path:
    """The file that names a class first."""
    return next(
        scenario.note(agent, number)
        for number, row in zip(numbers, notes, strict=True)
        for agent, note in zip(scenario.agents, row, strict=True)
        if kind in note.kinds
    )
