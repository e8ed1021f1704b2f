"""V2X-Sim as coperception preprocesses it for detection: a pickled dict a vehicle and frame.

Layout: `{train,val,test}/agent{k}/{scene}_{frame}/0.npy`; agent 0 is the road-side unit. The files hold voxels of
0.25 × 0.25 × 0.4 m within ±32 m instead of points, poses relative to each other, and boxes of cars as targets of
anchors. What they do not hold is supplied: the ground is the fullest slice of an agent's voxels, heights are those of a
usual car, vehicles are followed by place and size. Returns from the carrier itself are left out.
"""

from __future__ import annotations

import hashlib
import uuid
from collections.abc import Sequence
from dataclasses import fields
from functools import lru_cache
from pathlib import Path

import numpy as np
from jaxtyping import Float

from cp_env.lidar.returns import count_returns, standing, to_world_axes
from cp_env.progress import track
from cp_env.scenes.assembly.road import DRAWN, Road
from cp_env.scenes.errors import BrokenData, sift
from cp_env.scenes.formats.plain_numpy import load_npz
from cp_env.scenes.v2xsim.anchors import CELL, SLICE
from cp_env.scenes.v2xsim.build import RSU
from cp_env.scenes.v2xsim.preprocessed_build import AGENTS, HEIGHT, FrameSequence, read_points, read_sequence
from cp_env.scenes.v2xsim.splits import SPLITS
from cp_env.types import Scene, Sweep

VERSION = 3
"""Part of the digest: rises when the same files give other scenes."""

DT = 0.2  # s
ROUGH = 2 * SLICE  # m: the road under a sensor is known to a slice; what differs by less than two may be level
CLASS = "vehicle.car"
_Files = tuple[tuple[Path | None, ...], ...]  # [frame][agent]; None where the set has no folder of the agent


class V2XSimDet:
    """Scenes of a folder of coperception's detection files (a `SceneSource`), as `V2XSim` gives the raw ones.

    Args:
        path: the folder that holds `train`, `val`, `test`.
        split: one of them, or "all".
        scenes: only these, by number or name ("5" or "scene_5").
        vehicles: leave out scenes with fewer vehicles present in every frame.
        rsu: whether scenes show their road-side unit, where it has files.
        skip_broken: leave broken scenes out, and list them in `left_out`, instead of raising.
        progress: show a bar while scenes are put together, once; the result is kept in the user's cache directory.

    Raises:
        BrokenData: a missing, broken or hostile file, with its name and the reason.
        ValueError: no such split or scene, or none left.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        split: str = "all",
        scenes: tuple[str, ...] = (),
        vehicles: int = 1,
        rsu: bool = True,
        skip_broken: bool = False,
        progress: bool = True,
    ) -> None:
        self.name = f"v2x-sim-det/{split}"
        self._rsu = rsu
        every = _find(Path(path), split)
        chosen = [scene if scene.startswith("scene_") else f"scene_{scene}" for scene in scenes] or list(every)
        unknown = [scene for scene in chosen if scene not in every]
        if unknown:
            raise ValueError(f"{unknown[0]!r} is not in split {split!r} of {path}, which holds {', '.join(every)}")
        self._files: dict[str, _Files] = {name: every[name] for name in chosen}
        shown = track(chosen, f"reading {path}", unit="scene") if progress else chosen
        kept, self.left_out = sift(shown, lambda name: self._sequence(name), skip_broken=skip_broken)
        self._names = tuple(name for name in kept if len(self._sequence(name).agents) >= max(vehicles, 1))
        if not self._names:
            raise ValueError(f"no scene of {self.name} in {path} has {vehicles} vehicles in every frame; ask for fewer")
        keys = [_key(self._files[name]) for name in self._names]
        self.digest = hashlib.sha256(repr(("v2x-sim-det", VERSION, rsu, keys)).encode()).hexdigest()

    def names(self) -> tuple[str, ...]:
        """The scenes chosen, by number."""
        return self._names

    def load(self, name: str) -> Scene:
        """One scene.

        Raises:
            ValueError: unknown name.
        """
        if name not in self._names:
            raise ValueError(f"unknown scene {name!r}; {self.name} holds {', '.join(self._names)}")
        sequence = self._sequence(name)
        mast = None
        if self._rsu and not np.isnan(sequence.world_T_sensor[:, RSU]).any():
            mast = np.array([0.0, 0.0, -sequence.ground[RSU]])
        return Scene(
            name=name,
            kind="intersection",
            dt=DT,
            pose=sequence.pose,
            size=np.concatenate([sequence.size, np.full((len(sequence.size), 1), HEIGHT)], axis=1),
            connected=np.arange(len(sequence.agents)),
            rsu=mast,
            obstacles=np.zeros((0, 6)),
        )

    def sweeps(self, scene: Scene, frames: Sequence[int]) -> list[list[Sweep]]:
        """`[frame][agent]`: the connected vehicles in order, then the road-side unit if the scene shows one.

        Raises:
            BrokenData: a file is missing or broken.
        """
        sequence = self._sequence(scene.name)
        agents = [*sequence.agents.tolist(), *([RSU] if scene.rsu is not None else [])]
        return [[self._sweep(scene, sequence, int(t), k, agent) for k, agent in enumerate(agents)] for t in frames]

    def classes(self, scene: Scene) -> tuple[str, ...]:
        """The class of each of the scene's vehicles: the files hold cars and police cars, and do not say which."""
        return (CLASS,) * len(scene.size)

    def _sequence(self, name: str) -> FrameSequence:
        return _sequence(self._files[name])

    def _sweep(self, scene: Scene, sequence: FrameSequence, t: int, k: int, agent: int) -> Sweep:
        world_T_sensor = sequence.world_T_sensor[t, agent]
        place = scene.pose[t, scene.connected[k], :2] if agent != RSU else np.zeros(2)
        feet = _feet(sequence, t)
        road = Road.through(feet, place, float(feet[agent, 2]), DRAWN, flat=ROUGH)
        path = self._files[scene.name][t][agent]
        assert path is not None
        own = None if agent == RSU else int(scene.connected[k])
        boxes = standing(scene, t, place)
        shift = world_T_sensor[:, 3] - (*place, road.level)
        points, hits = to_world_axes(
            read_points(path, agent), world_T_sensor[:, :3], shift, boxes, own, margin=CELL / 2
        )
        if not road.is_level:  # the files hold no heights: boxes stand on the road that the agents make
            points = road.flatten(points)
            hits = count_returns(points, boxes, CELL / 2)
        return Sweep(points.astype(np.float32), np.append(place, shift[2]), hits)


def _feet(sequence: FrameSequence, t: int) -> Float[np.ndarray, "K 3"]:
    """Where the road is under each agent's sensor in frame t, by the fullest slice of its voxels; NaN if absent."""
    world_T_sensor = sequence.world_T_sensor[t]
    z = world_T_sensor[:, 2, 2] * sequence.ground + world_T_sensor[:, 2, 3]
    return np.column_stack([world_T_sensor[:, :2, 3], z])


def _find(root: Path, split: str) -> dict[str, _Files]:
    """Files `[frame][agent]` of every scene of a split."""
    if split not in SPLITS:
        raise ValueError(f"split must be one of {', '.join(SPLITS)}; got {split!r}")
    found: dict[int, _Files] = {}
    for part in SPLITS[1:] if split == "all" else (split,):
        last: dict[int, int] = {}
        for folder in root.glob(f"{part}/agent*/*_*"):
            scene, _, frame = folder.name.partition("_")
            if scene.isdigit() and frame.isdigit():
                last[int(scene)] = max(last.get(int(scene), 0), int(frame))
        folders = [root / part / f"agent{agent}" for agent in range(AGENTS)]
        agents = [folder if folder.is_dir() else None for folder in folders]
        for number, end in last.items():
            found[number] = tuple(
                tuple(folder and folder / f"{number}_{frame}" / "0.npy" for folder in agents)
                for frame in range(end + 1)
            )
    if not found:
        raise BrokenData(root, f"it holds no files {split}/agent<k>/<scene>_<frame>/0.npy")
    return {f"scene_{number}": found[number] for number in sorted(found)}


def _key(files: _Files) -> str:
    """A hash that changes with any file of a scene; BrokenData if one is missing."""
    sha = hashlib.sha256(repr(VERSION).encode())
    for path in (path for row in files for path in row if path is not None):
        try:
            found = path.stat()
        except OSError as error:
            raise BrokenData(path, "missing file") from error
        sha.update(repr((str(path.relative_to(path.parents[3])), found.st_size, found.st_mtime_ns)).encode())
    return sha.hexdigest()[:32]


@lru_cache(maxsize=16)
def _sequence(files: _Files) -> FrameSequence:
    """A scene, from the cache if it was put together before."""
    from cp_env.paths import cache_directory

    path = cache_directory() / "v2x-sim-det" / f"{_key(files)}.npz"
    try:
        return FrameSequence(**load_npz(path))
    except (OSError, ValueError, TypeError):  # not there, or not as it was written: it is made anew
        sequence = read_sequence(files)
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_name(f".{path.stem}-{uuid.uuid4().hex}.npz")
    np.savez(draft, **{field.name: getattr(sequence, field.name) for field in fields(sequence)})
    draft.replace(path)
    return sequence
