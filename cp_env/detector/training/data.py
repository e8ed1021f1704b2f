"""Training data: sweeps rasterised once and kept packed on disk, and random views drawn from them.

A scene takes two files in the cache: its packed grids and the rest; and one more for every encoder whose maps of them
are kept. They are renamed into place when they are whole, so that a run killed while preparing goes on with the scene
it was at.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
import torch
from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor

from cp_env.detector.model import bev
from cp_env.detector.model.detector import Detector
from cp_env.detector.training.loss import Targets, stack, targets
from cp_env.geometry.planar import LATTICE, grid_origin
from cp_env.lidar.returns import returns_of
from cp_env.progress import track
from cp_env.scenes.errors import BrokenData
from cp_env.scenes.formats.plain_numpy import load_npz, map_npy
from cp_env.types import Scene, SceneSource

T = TypeVar("T")

RETURNS_SEEN = 3
"""A group sees a vehicle of which its sensors have at least this many returns together."""


@dataclass(frozen=True, eq=False)
class RasterisedScene:
    """The recorded grids of one scene; agents are its connected vehicles in order, then its road-side unit."""

    packed: UInt8[np.ndarray, "F A Z R P"]  # occupancy, eight cells a byte; a memory map
    origin: Float[np.ndarray, "F A 2"]  # of each agent's grid frame in the world; m
    hits: Int[np.ndarray, "F A M"]  # returns of each agent from each vehicle
    boxes: Float[np.ndarray, "F M 5"]  # in the world; NaN where absent
    connected: Int[np.ndarray, " V"]  # rows of the connected vehicles
    maps: Float[np.ndarray, "F A C H W"] | None = None  # what a fixed encoder makes of the grids; a memory map

    @property
    def n_frames(self) -> int:
        return len(self.packed)


@dataclass(frozen=True, eq=False)
class Batch:
    """Views of E random egos on S sweeps; `agent[e, n]` is the sweep of ego e's map n (any, if n is in no group).

    The ego's own map is number 0.
    """

    occupancy: UInt8[Tensor, "S Z R R"]
    maps: Float[Tensor, "S C H W"] | None  # of the same sweeps, where the scenes have them
    agent: Int[Tensor, "E N"]
    ego_T_sender: Float[Tensor, "E N 3"]
    world: Int[Tensor, " B"]
    groups: Bool[Tensor, "B N"]
    targets: Targets  # of the B views

    def to(self, device: str | torch.device) -> Batch:
        """The same on `device`."""
        return Batch(
            self.occupancy.to(device),
            None if self.maps is None else self.maps.to(device),
            self.agent.to(device),
            self.ego_T_sender.to(device),
            self.world.to(device),
            self.groups.to(device),
            self.targets.to(device),
        )


def prepare(source: SceneSource, cache: Path, *, stride: int = 2, limit: int | None = None) -> list[RasterisedScene]:
    """The rasterised scenes of a source (every `stride`-th frame), from the cache where it holds them."""
    key = hashlib.sha256(f"{source.digest} {bev.BEV} {LATTICE} {stride}".encode()).hexdigest()[:16]
    folder = cache / key
    folder.mkdir(parents=True, exist_ok=True)
    names = source.names()[:limit]
    return [
        _rasterised(source, name, folder, stride) for name in track(names, f"sweeps of {source.name}", unit="scene")
    ]


def _rasterised(source: SceneSource, name: str, folder: Path, stride: int) -> RasterisedScene:
    grids, rest = folder / f"{name}.npy", folder / f"{name}.npz"
    if not rest.exists():
        _record(source, source.load(name), grids, rest, stride)
    return RasterisedScene(_kept(grids, map_npy), **_kept(rest, load_npz))


def _kept(path: Path, read: Callable[[Path], T]) -> T:
    """What a file of the cache holds.

    Raises:
        BrokenData: it cannot be read; the way out is named.
    """
    try:
        return read(path)
    except (OSError, ValueError) as error:
        raise BrokenData(path, f"{error}; delete {path.parent}, what it holds is made again") from error


def _record(source: SceneSource, scene: Scene, grids: Path, rest: Path, stride: int) -> None:
    frames = range(0, scene.n_frames, stride)
    packed, origin, hits = [], [], []
    for start in range(0, len(frames), 5):
        part = frames[start : start + 5]
        for frame, sweeps in zip(part, source.sweeps(scene, part), strict=True):
            packed.append(bev.pack(bev.rasterise(sweeps)))
            origin.append([grid_origin(sweep.origin[:2]) for sweep in sweeps])
            hits.append([returns_of(scene, frame, sweep) for sweep in sweeps])
    kept = np.asarray(frames)
    size = np.broadcast_to(scene.size[:, :2], (len(kept), len(scene.size), 2))
    boxes = np.concatenate([scene.pose[kept, :, :2], size, scene.pose[kept, :, 2:]], axis=-1)
    partial = grids.with_suffix(".part.npy"), rest.with_suffix(".part.npz")
    np.save(partial[0], np.stack(packed))
    np.savez(
        partial[1],
        origin=np.array(origin, dtype=np.float64),
        hits=np.array(hits, dtype=np.int32),
        boxes=boxes.astype(np.float64),
        connected=np.asarray(scene.connected, dtype=np.int64),
    )
    partial[0].rename(grids)
    partial[1].rename(rest)


@torch.no_grad()
def encode(scenes: Sequence[RasterisedScene], detector: Detector, folder: Path) -> list[RasterisedScene]:
    """The scenes with the maps that the detector's encoder makes of them, half precision, cached in `folder`.

    The name of the folder must differ between encoders and between scenes. The detector is put into evaluation mode.
    """
    folder.mkdir(parents=True, exist_ok=True)
    detector.eval()
    return [
        replace(rasterised, maps=_encoded(rasterised, detector, folder / f"{number:03d}.npy"))
        for number, rasterised in enumerate(track(scenes, "maps", unit="scene"))
    ]


def _encoded(rasterised: RasterisedScene, detector: Detector, path: Path) -> Float[np.ndarray, "F A C H W"]:
    if not path.exists():
        maps = [detector.encode_grids(bev.unpack(frame)).half().cpu().numpy() for frame in rasterised.packed]
        partial = path.with_suffix(".part.npy")
        np.save(partial, np.stack(maps))
        partial.rename(path)
    return _kept(path, map_npy)


def draw(
    scenes: Sequence[RasterisedScene],
    rng: np.random.Generator,
    *,
    frames: int,
    egos: int = 2,
    views: int = 4,
    agents: int = 5,
    extent: float = 32.0,
    size: int = 64,
) -> Batch:
    """A random batch of `frames` frames, at most `agents` agents in each, `egos` of them the centre of `views` groups.

    The first group is everyone; the others have a random size and random members, one of them never the ego. A frame is
    turned or mirrored at random, exactly: sensor grids, positions and boxes together. A scene that comes with maps is
    left as it is, for an encoder's map of a mirrored grid is not the mirrored map.
    """
    occupancy: list[Tensor] = []
    maps: list[Tensor] = []
    agent: list[Int[np.ndarray, " N"]] = []
    poses: list[Float[np.ndarray, "N 3"]] = []
    groups: list[Bool[np.ndarray, "B N"]] = []
    wanted: list[Targets] = []
    for _ in range(frames):
        rasterised = scenes[int(rng.integers(len(scenes)))]
        frame = int(rng.integers(rasterised.n_frames))
        present = _select(rasterised, rng, agents)
        first, spare = sum(len(grids) for grids in occupancy), agents - len(present)
        mirror = (rng.random(3) < 0.5) & (rasterised.maps is None)
        occupancy.append(_mirror_grids(bev.unpack(rasterised.packed[frame, present]), mirror))
        if rasterised.maps is not None:
            maps.append(torch.from_numpy(rasterised.maps[frame, present]).float())
        vehicles = np.flatnonzero(present < len(rasterised.connected))
        for ego in rng.permutation(vehicles)[:egos].tolist():
            members = _groups(rng, len(present), ego, views)
            boxes, visible = _truth(rasterised, frame, present, ego, members, extent)
            boxes = _mirror_boxes(boxes, mirror)
            wanted.append(targets(torch.from_numpy(boxes), torch.from_numpy(visible), size, extent))
            offset = rasterised.origin[frame, present] - rasterised.origin[frame, present[ego]]
            order = np.argsort(np.arange(len(present)) != ego, kind="stable")  # the ego first
            poses.append(np.pad(_mirror_points(offset[order], mirror), ((0, spare), (0, 1))))
            agent.append(np.pad(first + order, (0, spare), constant_values=first))
            groups.append(np.pad(members[:, order], ((0, 0), (0, spare))))
    return Batch(
        torch.cat(occupancy),
        torch.cat(maps) if maps else None,
        torch.from_numpy(np.stack(agent)),
        torch.from_numpy(np.stack(poses)).float(),
        torch.from_numpy(np.repeat(np.arange(len(groups)), [len(members) for members in groups])),
        torch.from_numpy(np.concatenate(groups)),
        stack(wanted),
    )


def _select(rasterised: RasterisedScene, rng: np.random.Generator, agents: int) -> Int[np.ndarray, " A"]:
    """Which agents take part: at least one connected vehicle, at most `agents` in all; the road-side unit at times."""
    vehicles = rng.permutation(len(rasterised.connected))
    others = np.arange(len(rasterised.connected), rasterised.packed.shape[1])
    if len(others) and rng.random() < 0.3:
        return np.concatenate([vehicles[: agents - 1], others[:1]])
    return vehicles[:agents]


def _groups(rng: np.random.Generator, n: int, ego: int, views: int) -> Bool[np.ndarray, "B N"]:
    """Everyone, then random groups, the last of which lacks the ego if there is anyone else."""
    groups = np.zeros((views, n), dtype=bool)
    groups[0] = True
    for view in range(1, views):
        pool = np.delete(np.arange(n), ego) if view == views - 1 and n > 1 else np.arange(n)
        groups[view, rng.permutation(pool)[: rng.integers(1, len(pool) + 1)]] = True
    return groups


def _truth(
    rasterised: RasterisedScene,
    frame: int,
    present: Int[np.ndarray, " A"],
    ego: int,
    groups: Bool[np.ndarray, "B N"],
    extent: float,
) -> tuple[Float[np.ndarray, "L 5"], Bool[np.ndarray, "B L"]]:
    """All boxes near the ego (its own among them) in its grid frame, and which of them each group sees."""
    boxes = rasterised.boxes[frame].copy()
    boxes[:, :2] -= rasterised.origin[frame, present[ego]]
    rows = np.flatnonzero((np.abs(boxes[:, :2]) < extent + 2).all(axis=1))
    returns = groups.astype(np.int64) @ rasterised.hits[frame][present][:, rows]
    return boxes[rows].astype(np.float32), returns >= RETURNS_SEEN


def _mirror_grids(grids: UInt8[Tensor, "A Z R R"], mirror: Bool[np.ndarray, "3"]) -> UInt8[Tensor, "A Z R R"]:
    """Mirror x, mirror y, swap x and y, as `mirror` says: all eight symmetries of the square."""
    axes = [axis for axis, flip in ((-1, mirror[0]), (-2, mirror[1])) if flip]
    grids = grids.flip(axes)
    return grids.transpose(-1, -2) if mirror[2] else grids


def _mirror_points(points: Float[np.ndarray, "*n 2"], mirror: Bool[np.ndarray, "3"]) -> Float[np.ndarray, "*n 2"]:
    points = points * np.where(mirror[:2], -1, 1)
    return points[..., ::-1] if mirror[2] else points


def _mirror_boxes(boxes: Float[np.ndarray, "L 5"], mirror: Bool[np.ndarray, "3"]) -> Float[np.ndarray, "L 5"]:
    heading = np.stack([np.cos(boxes[:, 4]), np.sin(boxes[:, 4])], axis=-1)
    x, y = _mirror_points(heading, mirror).T
    centre = _mirror_points(boxes[:, :2], mirror)
    return np.concatenate([centre, boxes[:, 2:4], np.arctan2(y, x)[:, None]], axis=1).astype(np.float32)
