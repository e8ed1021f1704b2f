"""What tables in the nuScenes format say about LiDARs and boxes, kept as one small file a scene.

V2X-Sim has many LiDARs and keyframes alone; nuScenes has one, and sweeps between its keyframes. Faults of single scenes
are part of the index: whoever opens the set decides whether they matter.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from cp_env.scenes.errors import BrokenData
from cp_env.scenes.formats.bounded import parse_json, read_bytes
from cp_env.scenes.formats.plain_numpy import load_npz


@dataclass(frozen=True)
class Channels:
    """The LiDARs of a family of data.

    Attributes:
        title: of the data.
        pattern: of a channel's name; a group in it is the agent's number, and without one it is agent 1.
        named: the channels in words.
        between: whether sweeps between keyframes are kept.
    """

    title: str
    pattern: str
    named: str
    between: bool

    def agent(self, channel: str) -> int | None:
        """Whose LiDAR it is; None if it is none."""
        found = re.fullmatch(self.pattern, channel)
        return None if found is None else int(found[1]) if found.re.groups else 1


V2X_SIM = Channels("V2X-Sim 2.0", r"LIDAR_TOP_id_(\d{1,3})", "LIDAR_TOP_id_k", False)
NUSCENES = Channels("nuScenes", "LIDAR_TOP", "LIDAR_TOP", True)
INDEX_BYTES = 64 << 20
"""The index of a set is at most so long."""


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
    world_T_ego: Float[np.ndarray, "T K 3 4"]  # where the carrier says it is; its foot in most sets
    sweep: np.ndarray  # T × K file names, relative to the set's folder
    between_time: Float[np.ndarray, " S"]  # s; of sweeps of agent 1 that are no keyframe's, in order
    between_sensor: Float[np.ndarray, "S 3 4"]  # world_T_sensor of each
    between_ego: Float[np.ndarray, "S 3 4"]
    between_sweep: np.ndarray  # S file names
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
        file = self.folder / f"{number}.npz"
        try:
            return Rows(**load_npz(file))
        except (OSError, ValueError, TypeError) as error:
            raise BrokenData(file, f"it is a cached index that cannot be read: {error}; delete its folder") from error


def read_index(folder: Path) -> Index:
    """The index in a folder.

    Raises:
        BrokenData: it is not as it was written.
    """
    file = folder / "index.json"
    try:
        said = parse_json(read_bytes(file, INDEX_BYTES), limit=INDEX_BYTES)
        entries = tuple(Entry(e["name"], e["description"], e["fault"] and tuple(e["fault"])) for e in said["entries"])
        return Index(folder, said["digest"], tuple(said["categories"]), entries)
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise BrokenData(file, f"it is a cached index that cannot be read: {error}; delete its folder") from error
