"""What V2X-Sim's tables say about LiDARs and boxes, gathered once and kept as one small file a scene.

The index lies in the user's cache directory under a key of the tables' sizes and times; deleting it loses nothing but
time. Faults of single scenes are part of it: whoever opens the set decides whether they matter.
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
from jaxtyping import Float, Int

from cp_env.geometry import spatial
from cp_env.scenes.errors import BrokenData
from cp_env.scenes.v2xsim import tilt
from cp_env.scenes.v2xsim.tables import TABLES, Tables

VERSION = 3
_CHANNEL = re.compile(r"LIDAR_TOP_id_(\d+)")
_NAME = re.compile(r"[\w-][\w.-]*")


@dataclass(frozen=True)
class Entry:
    """One scene of the set, as `scene.json` orders them."""

    name: str
    description: str
    fault: tuple[str, str] | None = None  # file and reason, if its records contradict each other


@dataclass(frozen=True, eq=False)
class Rows:
    """The records of one scene. Agent k is channel LIDAR_TOP_id_k; NaN and an empty name where it is absent."""

    time: Float[np.ndarray, " T"]  # s
    world_T_sensor: Float[np.ndarray, "T K 3 4"]
    base: Float[np.ndarray, "T K"]  # z of the ego pose, m
    sweep: np.ndarray  # T × K file names, relative to the set's folder
    frame: Int[np.ndarray, " B"]  # of each box
    instance: Int[np.ndarray, " B"]
    category: Int[np.ndarray, " B"]  # number in `Index.categories`
    box: Float[np.ndarray, "B 7"]  # x, y, z of the middle, length, width, height, yaw; world
    tilt: Float[np.ndarray, "B 2"]  # roll, pitch of each box, as in `tilt`; rad


@dataclass(frozen=True)
class Index:
    """Scenes and categories of a set; `digest` is a hash of the tables' contents."""

    folder: Path
    digest: str
    categories: tuple[str, ...]
    entries: tuple[Entry, ...]

    def rows(self, number: int) -> Rows:
        """Of the scene at `number` in `entries`, which must be without fault."""
        with np.load(self.folder / f"{number}.npz", allow_pickle=False) as arrays:
            return Rows(**{name: arrays[name] for name in arrays.files})


def open_index(tables: Path, *, progress: bool = True) -> Index:
    """The index of a folder of tables, made now if it is not in the cache.

    Raises:
        BrokenData: a table that cannot be read, or a record that belongs to no scene.
    """
    from cp_env.paths import cache_directory

    stats = [(name, (tables / f"{name}.json").stat()) for name in TABLES]
    key = repr((VERSION, str(tables.resolve()), [(name, s.st_size, s.st_mtime_ns) for name, s in stats]))
    folder = cache_directory() / "v2x-sim" / hashlib.sha256(key.encode()).hexdigest()[:16]
    if not (folder / "index.json").is_file():
        draft = folder.with_name(f".{folder.name}-{uuid.uuid4().hex}")
        draft.mkdir(parents=True)
        try:
            _Builder(Tables(tables, progress), draft).build()
            if not folder.is_dir():
                draft.rename(folder)
        finally:
            shutil.rmtree(draft, ignore_errors=True)
    content = json.loads((folder / "index.json").read_text())
    entries = tuple(Entry(e["name"], e["description"], e["fault"] and tuple(e["fault"])) for e in content["entries"])
    return Index(folder, content["digest"], tuple(content["categories"]), entries)


class _Builder:
    """One pass over every table, in an order in which each refers to what was read before."""

    def __init__(self, tables: Tables, out: Path) -> None:
        self.tables, self.out = tables, out
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
                self.tables.path(table), f"a record refers to {what} {token!r}, which is not there"
            ) from error

    def _new(self, found: Container[str], token: Any, table: str) -> None:
        """BrokenData unless this is the first record of that token."""
        if not isinstance(token, str) or token in found:
            raise BrokenData(
                self.tables.path(table),
                f"two records have the token {token!r}" if isinstance(token, str) else f"a token is {token!r}",
            )

    def _scenes(self) -> None:
        table = list(self.tables.read("scene", "token", "name", "description", "first_sample_token"))
        self.names = [str(name) for _, name, _, _ in table]
        wrong = [name for k, name in enumerate(self.names) if not _NAME.fullmatch(name) or name in self.names[:k]]
        if wrong or not table:
            raise BrokenData(
                self.tables.path("scene"),
                f"scenes need names, all different and fit for a file name; got {wrong[0] if wrong else 'none'!r}",
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
                    self._fault(scene, "sample", f"the chain of samples breaks at {token!r}, after {len(times)} frames")
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
            channel = _CHANNEL.fullmatch(self._find(channels, sensor, "calibrated_sensor", "sensor"))
            self._new(mounts, token, "calibrated_sensor")
            if channel:
                mounts[token] = (int(channel[1]), shift, turn)
        self.agents = 1 + max((agent for agent, _, _ in mounts.values()), default=-1)
        if not self.agents:
            raise BrokenData(
                self.tables.path("sensor"), "no channel LIDAR_TOP_id_k: these are no tables of V2X-Sim 2.0"
            )
        return mounts

    def _lidars(self) -> None:
        """Where each LiDAR is in each frame, and its file."""
        mounts = self._mounts()
        shots: dict[str, list[tuple[int, int, int, str, str]]] = {}  # by ego pose
        for sample, mount, pose, file, key in self.tables.read(
            "sample_data", "sample_token", "calibrated_sensor_token", "ego_pose_token", "filename", "is_key_frame"
        ):
            if mount in mounts and key:
                scene = self._find(self.sample_of, sample, "sample_data", "sample")
                if sample in self.place:
                    shots.setdefault(pose, []).append((scene, self.place[sample][1], mounts[mount][0], mount, file))
        self.world_T_sensor = [np.full((len(times), self.agents, 3, 4), np.nan) for times in self.times]
        self.base = [np.full((len(times), self.agents), np.nan) for times in self.times]
        self.files = [[[""] * self.agents for _ in times] for times in self.times]
        met: set[str] = set()
        for token, shift, turn in self.tables.read("ego_pose", "token", "translation", "rotation"):
            self._new(met, token, "ego_pose")
            met.update({token} & shots.keys())
            for scene, frame, agent, mount, file in shots.pop(token, ()):
                self._shot(scene, frame, agent, (shift, turn), mounts[mount][1:], file)
        for token, lost in shots.items():
            for scene, *_ in lost:
                self._fault(scene, "sample_data", f"a record refers to ego pose {token!r}, which is not there")

    def _shot(self, scene: int, frame: int, agent: int, pose: Any, mount: Any, file: str) -> None:
        if self.files[scene][frame][agent]:
            self._fault(scene, "sample_data", f"two sweeps of LIDAR_TOP_id_{agent} in frame {frame}")
        try:
            world_T_carrier, carrier_T_sensor = _motion(*pose), _motion(*mount)
        except (ValueError, TypeError) as error:
            self._fault(scene, "ego_pose", f"LIDAR_TOP_id_{agent} in frame {frame}: {error}")
            return
        self.world_T_sensor[scene][frame, agent] = spatial.chain(world_T_carrier, carrier_T_sensor)
        self.base[scene][frame, agent] = world_T_carrier[2, 3]
        self.files[scene][frame][agent] = file

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
                self._fault(scene, "sample_annotation", f"a record refers to instance {instance!r}, which is not there")
                continue
            try:
                numbers = _numbers(middle, 3) + _numbers(size, 3) + _unit(turn)
                if min(numbers[3:6]) <= 0:
                    raise ValueError(f"size {size} is not positive")
            except (ValueError, TypeError) as error:
                self._fault(scene, "sample_annotation", f"a box in frame {self.place[sample][1]}: {error}")
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
        yaw, *tilts = tilt.attitude(spatial.rotation(box[:, 6:])).T
        np.savez(
            self.out / f"{scene}.npz",
            time=np.array(self.times[scene]),
            world_T_sensor=self.world_T_sensor[scene],
            base=self.base[scene],
            sweep=np.array(self.files[scene], dtype=np.str_),
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
        raise ValueError(f"rotation {turn} is no unit quaternion")
    return [value / norm for value in quaternion]


def _numbers(values: Any, n: int) -> list[float]:
    numbers = [float(value) for value in values]
    if len(numbers) != n or not np.isfinite(numbers).all():
        raise ValueError(f"{n} finite numbers are needed, not {values}")
    return numbers
