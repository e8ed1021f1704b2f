"""The files of OPV2V and V2XSet: `<scenario>/<agent>/<number>.yaml` and `.pcd`.

An agent's name is its vehicle's number in CARLA; a road-side unit's is negative. Files are numbered by CARLA's ticks.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from cp_env.scenes.errors import BrokenData

NEEDS_YAML = "reading OPV2V needs PyYAML; install this package with its extra: pip install '.[opv2v]'"
_KEPT = re.compile(
    r"^(?:lidar_pose|true_ego_pos|predicted_ego_pos|vehicles)\s*:.*\n?(?:[ \t#-].*\n?|\n)*", re.MULTILINE
)


@dataclass(frozen=True)
class Scenario:
    """One folder: agents in the order of OpenCOOD (names sorted as text, the first is the ego), and their frames."""

    folder: Path
    vehicles: tuple[str, ...]
    rsu: str | None
    numbers: tuple[str, ...]  # of the frames, as written: "000069"

    @property
    def agents(self) -> tuple[str, ...]:
        return self.vehicles if self.rsu is None else (*self.vehicles, self.rsu)

    def file(self, agent: str, number: str, suffix: str) -> Path:
        return self.folder / agent / f"{number}{suffix}"

    @property
    def ticks(self) -> int:
        """CARLA's ticks from frame to frame: the most frequent difference of two numbers."""
        steps = [int(b) - int(a) for a, b in pairwise(self.numbers)]
        return max(set(steps), key=steps.count) if steps else 2


@dataclass(frozen=True)
class Listed:
    """A vehicle as an agent's file lists it, in CARLA's axes; m, degrees."""

    location: Float[np.ndarray, " 3"]  # of its origin, on the ground between its wheels
    angle: Float[np.ndarray, " 3"]  # roll, yaw, pitch
    center: Float[np.ndarray, " 3"]  # of its box, from the origin along its own axes
    extent: Float[np.ndarray, " 3"]  # half of length, width, height

    @property
    def pose(self) -> Float[np.ndarray, " 6"]:
        return np.concatenate([self.location, self.angle])


@dataclass(frozen=True)
class Note:
    """What one agent's file says of one frame, in CARLA's axes; poses are (x, y, z, roll, yaw, pitch)."""

    lidar: Float[np.ndarray, " 6"]
    body: Float[np.ndarray, " 6"] | None  # of the agent's own origin
    predicted: Float[np.ndarray, " 6"] | None  # the same, as it believed
    vehicles: dict[int, Listed]  # those it met with at least one ray


def scenarios(root: Path) -> dict[str, Path]:
    """Folders in `root` that hold folders named by numbers, by name.

    Raises:
        BrokenData: there is no such folder.
    """
    if not root.is_dir():
        raise BrokenData(root, "is no folder")
    found = {folder.name: folder for folder in sorted(root.iterdir()) if folder.is_dir() and _agents(folder)}
    if not found:
        inner = [folder.name for folder in sorted(root.iterdir()) if folder.is_dir() and _holds_scenarios(folder)]
        hint = f"; it has the splits {', '.join(inner)}: choose one with split=" if inner else ""
        raise BrokenData(root, f"holds no scenario (a folder of numbered agents' folders){hint}")
    return found


def _holds_scenarios(folder: Path) -> bool:
    return any(_agents(inner) for inner in folder.iterdir() if inner.is_dir())


def _agents(folder: Path) -> list[str]:
    return sorted(inner.name for inner in folder.iterdir() if re.fullmatch(r"-?\d+", inner.name) and inner.is_dir())


def survey(folder: Path) -> Scenario:
    """The agents and frames of a scenario; of several road-side units the first is kept.

    Raises:
        BrokenData: no vehicle, no frame, or an agent that lacks a file of a frame that the ego has.
    """
    agents = _agents(folder)
    vehicles = tuple(agent for agent in agents if int(agent) >= 0)
    units = [agent for agent in agents if int(agent) < 0]
    if not vehicles:
        raise BrokenData(folder, "holds no vehicle's folder")
    there = {agent: {file.name for file in (folder / agent).iterdir()} for agent in [*vehicles, *units[:1]]}
    numbers = sorted(name[:-5] for name in there[vehicles[0]] if re.fullmatch(r"\d+\.yaml", name))
    if not numbers:
        raise BrokenData(folder / vehicles[0], "holds no frame (a file like 000069.yaml)")
    for agent, names in there.items():
        for number in numbers:
            for suffix in (".yaml", ".pcd"):
                if number + suffix not in names:
                    raise BrokenData(folder / agent / f"{number}{suffix}", "is missing")
    return Scenario(folder, vehicles, units[0] if units else None, tuple(numbers))


def read_note(path: Path) -> Note:
    """One agent's file of one frame.

    Raises:
        BrokenData: it is missing, no YAML, lacks something, or holds a number that is none.
        ImportError: PyYAML is not installed.
    """
    try:
        import yaml
    except ImportError as error:
        raise ImportError(NEEDS_YAML) from error
    try:
        kept = "".join(_KEPT.findall(path.read_text()))  # cameras and plans take longer to parse than all the rest
        said = yaml.load(kept, getattr(yaml, "CSafeLoader", yaml.SafeLoader))
        return _note(said if isinstance(said, dict) else {})
    except OSError as error:
        raise BrokenData(path, f"cannot be read: {error.strerror}") from error
    except yaml.YAMLError as error:
        raise BrokenData(path, f"is no YAML: {' '.join(str(error).split())}") from error
    except (ValueError, TypeError, KeyError) as error:
        raise BrokenData(path, str(error).strip("'\"")) from error


def _note(said: dict[str, Any]) -> Note:
    if "lidar_pose" not in said:
        raise KeyError("lacks lidar_pose")
    body, predicted = (_numbers(said, key, 6) if key in said else None for key in ("true_ego_pos", "predicted_ego_pos"))
    vehicles, listed_there = {}, said.get("vehicles") or {}
    if not isinstance(listed_there, dict):
        raise ValueError(f"vehicles must be a table by number: got {listed_there!r}")
    for number, entry in listed_there.items():
        if not isinstance(entry, dict):
            raise ValueError(f"vehicle {number} is {entry!r}, not a table")
        listed = [_numbers(entry, key, 3, f"vehicle {number}: ") for key in ("location", "angle", "center", "extent")]
        if (listed[3] <= 0).any():
            raise ValueError(f"vehicle {number}: extent {listed[3].tolist()} is not positive")
        vehicles[int(number)] = Listed(*listed)
    return Note(_numbers(said, "lidar_pose", 6), body, predicted, vehicles)


def _numbers(table: dict[str, Any], key: str, count: int, where: str = "") -> Float[np.ndarray, " n"]:
    if key not in table:
        raise KeyError(f"{where}lacks {key}")
    numbers = np.array(table[key], dtype=np.float64)
    if numbers.shape != (count,) or not np.isfinite(numbers).all():
        raise ValueError(f"{where}{key} must be {count} finite numbers: got {table[key]}")
    return numbers
