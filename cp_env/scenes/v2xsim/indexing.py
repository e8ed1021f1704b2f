"""The index of a folder of tables, gathered in one pass over each.

It lies in the user's cache directory under a key of the tables' sizes and times; deleting it loses nothing but time.
"""

from __future__ import annotations

import hashlib
import json
import re
import shutil
import uuid
from array import array
from collections.abc import Container
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from cp_env.geometry import spatial
from cp_env.scenes.assembly import tilt
from cp_env.scenes.errors import BrokenData
from cp_env.scenes.v2xsim.index import V2X_SIM, Channels, Entry, Index, read_index
from cp_env.scenes.v2xsim.tables import TABLES, Tables

VERSION = 4
_NAME = re.compile(r"[\w-][\w.-]*")


def open_index(tables: Path, channels: Channels = V2X_SIM, *, progress: bool = True) -> Index:
    """The index of a folder of tables, made now if it is not in the cache.

    Raises:
        BrokenData: a table that cannot be read, or a record that belongs to no scene.
    """
    from cp_env.paths import cache_directory

    stats = [(name, (tables / f"{name}.json").stat()) for name in TABLES]
    key = repr((VERSION, channels, str(tables.resolve()), [(name, s.st_size, s.st_mtime_ns) for name, s in stats]))
    folder = cache_directory() / "v2x-sim" / hashlib.sha256(key.encode()).hexdigest()[:16]
    if not (folder / "index.json").is_file():
        draft = folder.with_name(f".{folder.name}-{uuid.uuid4().hex}")
        draft.mkdir(parents=True)
        try:
            try:
                _Builder(Tables(tables, progress), draft, channels).build()
            except TypeError as error:  # a list or a table in place of a token
                raise BrokenData(tables, f"a record refers to what is no token: {error!s:.200}") from error
            if not folder.is_dir():
                draft.rename(folder)
        finally:
            shutil.rmtree(draft, ignore_errors=True)
    return read_index(folder)


@dataclass(frozen=True)
class _Shot:
    """A sweep: its scene, the frame it belongs to, its LiDAR (agent, translation, rotation), and its record's rest."""

    scene: int
    frame: int
    mount: tuple[int, Any, Any]
    file: str
    key: bool
    stamp: Any = 0


class _Builder:
    """One pass over every table, in an order in which each refers to what was read before."""

    def __init__(self, tables: Tables, out: Path, channels: Channels) -> None:
        self.tables, self.out, self.channels = tables, out, channels
        self.faults: dict[int, tuple[str, str]] = {}

    def build(self) -> None:
        self._scenes()
        self._samples()
        self._lidars()
        self._boxes()
        for number in range(len(self.names)):
            self._finish(number)
        entries = [
            asdict(Entry(name, text, self.faults.get(number)))
            for number, (name, text) in enumerate(zip(self.names, self.descriptions, strict=True))
        ]
        content = {"digest": self.tables.digest(), "categories": list(self.categories), "entries": entries}
        (self.out / "index.json").write_text(json.dumps(content))

    def _fault(self, scene: int, table: str, reason: str) -> None:
        self.faults.setdefault(scene, (str(self.tables.path(table)), reason))

    def _find(self, found: dict[str, Any], token: Any, table: str, what: str) -> Any:
        """What `token` names; BrokenData if nothing."""
        try:
            return found[token]
        except (KeyError, TypeError) as error:
            raise BrokenData(
                self.tables.path(table), f"a record refers to {what} {token!r:.80}, which is not there"
            ) from error

    def _new(self, found: Container[str], token: Any, table: str) -> None:
        """BrokenData unless this is the first record of that token."""
        if not isinstance(token, str) or token in found:
            raise BrokenData(
                self.tables.path(table),
                f"two records have the token {token!r:.80}" if isinstance(token, str) else f"a token is {token!r:.80}",
            )

    def _scenes(self) -> None:
        table = list(self.tables.read("scene", "token", "name", "description", "first_sample_token"))
        self.names = [str(name) for _, name, _, _ in table]
        wrong = [name for k, name in enumerate(self.names) if not _NAME.fullmatch(name) or name in self.names[:k]]
        if wrong or not table:
            raise BrokenData(
                self.tables.path("scene"),
                f"scenes need names, all different and fit for a file name; got {wrong[0] if wrong else 'none'!r:.80}",
            )
        self.descriptions = [str(text) for _, _, text, _ in table]
        self.scene_of = {token: number for number, (token, *_) in enumerate(table)}
        self.first = [first for *_, first in table]

    def _samples(self) -> None:
        """The frames of each scene in order: its chain of samples."""
        following: dict[str, tuple[int, str, float]] = {}
        counts = [0] * len(self.names)
        for token, owner, after, stamp in self.tables.read("sample", "token", "scene_token", "next", "timestamp"):
            scene = self._find(self.scene_of, owner, "sample", "scene")
            self._new(following, token, "sample")
            following[token] = (scene, after, float(stamp) * 1e-6)
            counts[scene] += 1
        self.place: dict[str, tuple[int, int]] = {}  # of a sample: scene, frame
        self.times: list[list[float]] = []
        for scene, token in enumerate(self.first):
            times: list[float] = []
            while token:
                if token not in following or following[token][0] != scene or token in self.place:
                    self._fault(
                        scene, "sample", f"the chain of samples breaks at {token!r:.80}, after {len(times)} frames"
                    )
                    break
                self.place[token] = (scene, len(times))
                _, after, time = following[token]
                times.append(time)
                token = after
            else:
                if len(times) != counts[scene]:
                    self._fault(scene, "sample", f"the chain has {len(times)} of the scene's {counts[scene]} samples")
                elif len(times) > 1 and not np.all(np.diff(times) > 0):
                    self._fault(scene, "sample", "timestamps do not rise")
            self.times.append(times)
        self.sample_of = {token: scene for token, (scene, _, _) in following.items()}

    def _mounts(self) -> dict[str, tuple[int, Any, Any]]:
        """By token: the agent whose LiDAR it is, and the translation and rotation from its car."""
        channels: dict[str, str] = {}
        for token, channel in self.tables.read("sensor", "token", "channel"):
            self._new(channels, token, "sensor")
            channels[token] = str(channel)
        mounts: dict[str, tuple[int, Any, Any]] = {}
        for token, sensor, shift, turn in self.tables.read(
            "calibrated_sensor", "token", "sensor_token", "translation", "rotation"
        ):
            agent = self.channels.agent(self._find(channels, sensor, "calibrated_sensor", "sensor"))
            self._new(mounts, token, "calibrated_sensor")
            if agent is not None:
                mounts[token] = (agent, shift, turn)
        self.agents = 1 + max((agent for agent, _, _ in mounts.values()), default=-1)
        if not self.agents:
            raise BrokenData(
                self.tables.path("sensor"),
                f"no channel {self.channels.named}: these are no tables of {self.channels.title}",
            )
        return mounts

    def _lidars(self) -> None:
        """Where each LiDAR is in each frame, and its file."""
        mounts = self._mounts()
        shots: dict[str, list[_Shot]] = {}  # by ego pose
        fields = ["sample_token", "calibrated_sensor_token", "ego_pose_token", "filename", "is_key_frame"]
        fields += ["timestamp"] if self.channels.between else []
        for sample, mount, pose, file, key, *stamp in self.tables.read("sample_data", *fields):
            if mount in mounts and (key or self.channels.between):
                scene = self._find(self.sample_of, sample, "sample_data", "sample")
                if sample in self.place:
                    shot = _Shot(scene, self.place[sample][1], mounts[mount], str(file), bool(key), *stamp)
                    shots.setdefault(pose, []).append(shot)
        shape = [(len(times), self.agents) for times in self.times]
        self.world_T_sensor = [np.full((*size, 3, 4), np.nan) for size in shape]
        self.world_T_ego = [np.full((*size, 3, 4), np.nan) for size in shape]
        self.files = [[[""] * self.agents for _ in times] for times in self.times]
        self.between: list[list[tuple[float, str, Any, Any]]] = [[] for _ in self.times]
        met: set[str] = set()
        for token, shift, turn in self.tables.read("ego_pose", "token", "translation", "rotation"):
            self._new(met, token, "ego_pose")
            met.update({token} & shots.keys())
            for shot in shots.pop(token, ()):
                self._shot(shot, (shift, turn))
        for token, lost in shots.items():
            for shot in lost:
                self._fault(shot.scene, "sample_data", f"a record refers to ego pose {token!r:.80}, which is not there")

    def _shot(self, shot: _Shot, pose: Any) -> None:
        scene, frame, (agent, *mount) = shot.scene, shot.frame, shot.mount
        what = f"{self.channels.named.replace('k', str(agent))} in frame {frame}"
        if shot.key and self.files[scene][frame][agent]:
            self._fault(scene, "sample_data", f"two sweeps of {what}")
        try:
            world_T_ego, ego_T_sensor = _motion(*pose), _motion(*mount)
            stamp = float(shot.stamp) * 1e-6
        except (ValueError, TypeError) as error:
            self._fault(scene, "ego_pose", f"{what}: {error!s:.200}")
            return
        world_T_sensor = spatial.chain(world_T_ego, ego_T_sensor)
        if not shot.key:
            self.between[scene].append((stamp, shot.file, world_T_sensor, world_T_ego))
            return
        self.world_T_sensor[scene][frame, agent] = world_T_sensor
        self.world_T_ego[scene][frame, agent] = world_T_ego
        self.files[scene][frame][agent] = shot.file

    def _boxes(self) -> None:
        names: dict[str, str] = {}
        for token, name in self.tables.read("category", "token", "name"):
            self._new(names, token, "category")
            names[token] = str(name)
        self.categories = tuple(sorted(set(names.values())))
        number = {name: k for k, name in enumerate(self.categories)}
        kind: dict[str, tuple[int, int]] = {}  # of an instance: its number, its category's
        for token, category in self.tables.read("instance", "token", "category_token"):
            self._new(kind, token, "instance")
            kind[token] = (len(kind), number[self._find(names, category, "instance", "category")])
        where, box = array("q"), array("d")  # scene, frame, instance, category; the numbers as the table has them
        for sample, instance, middle, size, turn in self.tables.read(
            "sample_annotation", "sample_token", "instance_token", "translation", "size", "rotation"
        ):
            scene = self._find(self.sample_of, sample, "sample_annotation", "sample")
            if sample not in self.place:
                continue
            if instance not in kind:
                self._fault(
                    scene, "sample_annotation", f"a record refers to instance {instance!r:.80}, which is not there"
                )
                continue
            try:
                numbers = _numbers(middle, 3) + _numbers(size, 3) + _unit(turn)
                if min(numbers[3:6]) <= 0:
                    raise ValueError(f"size {size!s:.80} is not positive")
            except (ValueError, TypeError) as error:
                self._fault(scene, "sample_annotation", f"a box in frame {self.place[sample][1]}: {error!s:.200}")
                continue
            where.extend((*self.place[sample], *kind[instance]))
            box.extend(numbers)
        self.where, self.box = np.array(where).reshape(-1, 4), np.array(box).reshape(-1, 10)

    def _finish(self, scene: int) -> None:
        if not self.times[scene]:
            self._fault(scene, "scene", "a scene without samples")
        if scene in self.faults:
            return
        mine = self.where[:, 0] == scene
        where, box = self.where[mine], self.box[mine]
        met, times = np.unique(where[:, 1:3], axis=0, return_counts=True)
        if (times > 1).any():
            frame = met[times.argmax(), 0]
            self._fault(scene, "sample_annotation", f"two boxes of one instance in frame {frame}")
            return
        between = sorted(self.between[scene], key=lambda one: one[0])
        yaw, *tilts = tilt.attitude(spatial.rotation(box[:, 6:])).T
        np.savez(
            self.out / f"{scene}.npz",
            time=np.array(self.times[scene]),
            world_T_sensor=self.world_T_sensor[scene],
            world_T_ego=self.world_T_ego[scene],
            sweep=np.array(self.files[scene], dtype=np.str_),
            between_time=np.array([time for time, *_ in between]),
            between_sensor=np.array([pose for *_, pose, _ in between]).reshape(-1, 3, 4),
            between_ego=np.array([pose for *_, pose in between]).reshape(-1, 3, 4),
            between_sweep=np.array([file for _, file, *_ in between], dtype=np.str_),
            frame=where[:, 1],
            instance=where[:, 2],
            category=where[:, 3],
            box=np.concatenate([box[:, :3], box[:, [4, 3, 5]], yaw[:, None]], axis=1),  # the tables have width first
            tilt=np.stack(tilts, axis=1),
        )


def _motion(shift: Any, turn: Any) -> Float[np.ndarray, "3 4"]:
    return spatial.motion(np.array(_unit(turn)), np.array(_numbers(shift, 3)))


def _unit(turn: Any) -> list[float]:
    quaternion = _numbers(turn, 4)
    norm = float(np.linalg.norm(quaternion))
    if abs(norm - 1) > 0.01:
        raise ValueError(f"rotation {turn!s:.80} is no unit quaternion")
    return [value / norm for value in quaternion]


def _numbers(values: Any, n: int) -> list[float]:
    numbers = [float(value) for value in values]
    if len(numbers) != n or not np.isfinite(numbers).all():
        raise ValueError(f"{n} finite numbers are needed, not {values!s:.80}")
    return numbers
