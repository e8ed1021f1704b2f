"""The cache of encoded scenes: half-precision memory maps in the user's cache directory, one encoding a scene.

The cache key is a hash over the scene source and what the detector's maps depend on (`maps_digest`), so a stale entry
cannot be read, and detectors that fuse the same maps in different ways share theirs; deleting the directory loses
nothing but time. Processes share the files: each writes under a name of its own and then renames.
Set the environment variable `CP_ENV_CACHE` to keep the cache elsewhere.
"""

from __future__ import annotations

import os
import shutil
import uuid
import weakref
from collections import OrderedDict
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Shaped
from torch import Tensor
from tqdm import tqdm

from cp_env.detector.model.decoder import Dense
from cp_env.detector.protocol import DetectorLike, UsesEgoSweep, maps_digest, with_ego_context
from cp_env.geometry.planar import grid_origin
from cp_env.metrics.ground_truth import truth_boxes
from cp_env.paths import cache_directory
from cp_env.types import Endless, Scene, SceneSource, View
from cp_env.world.episode import Episode, ego_place, make_views

CHUNK = 10
"""Frames ray-cast and encoded together; bounds the memory of a first visit."""

KEPT = 64
"""Episodes whose clean views stay in memory; a hundred frames take about 8 MB."""


class SceneBank:
    """Encoded episodes of one source under one detector.

    A source with an attribute `endless` that is true gives scenes that hardly come back: their files are this bank's
    alone, and leave the disk when they leave memory (after `KEPT` others), at the latest with the bank.

    Raises ValueError when a scene holds fewer connected vehicles than asked for, or lacks a road-side unit that is.
    """

    def __init__(
        self, source: SceneSource, detector: DetectorLike, root: Path | None = None, progress: bool = True
    ) -> None:
        self.source, self.detector, self.progress = source, detector, progress
        self.root = (root or cache_directory()) / f"{source.digest}-{maps_digest(detector)}"
        self.endless = isinstance(source, Endless) and source.endless
        if self.endless:  # a folder of our own, which goes with us
            self.root /= uuid.uuid4().hex
            weakref.finalize(self, _drop, self.root, os.getpid())
        self._episodes: OrderedDict[tuple[str, int, bool], Episode] = OrderedDict()

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_episodes": OrderedDict()}

    def episode(self, name: str, n_vehicles: int, rsu: bool) -> Episode:
        """The episode of scene `name`; it is encoded now, with a progress bar, unless the cache holds it."""
        key = (name, n_vehicles, rsu)
        if key not in self._episodes:
            self._episodes[key] = self._build(name, n_vehicles, rsu)
        self._episodes.move_to_end(key)
        while len(self._episodes) > KEPT:
            (scene, *_), _ = self._episodes.popitem(last=False)
            if self.endless:
                _drop(self.root / scene, os.getpid())
        return self._episodes[key]

    def _build(self, name: str, n_vehicles: int, rsu: bool) -> Episode:
        scene = self.source.load(name)
        agents = self._agents(scene, n_vehicles, rsu)
        self._ensure(scene, agents)
        poses = torch.from_numpy(self._poses(scene, agents))
        features = tuple(self._open(scene, "features", agent) for agent in agents)
        received = tuple(self._open(scene, "received", agent) for agent in agents)
        coverage = self.detector.coverage(poses)
        ego_context = (
            np.load(self._path(scene, "kept", 0), mmap_mode="c", allow_pickle=False) if self._uses_ego_sweep else None
        )
        clean, views = self._clean(scene, received, coverage, ego_context)
        truth = tuple(
            truth_boxes(scene, t, int(scene.connected[0]), self.detector.extent) for t in range(scene.n_frames)
        )
        return Episode(scene, features, received, poses, coverage, clean, views, truth, ego_context)

    @property
    def _uses_ego_sweep(self) -> bool:
        return isinstance(self.detector, UsesEgoSweep)

    def _agents(self, scene: Scene, n_vehicles: int, rsu: bool) -> list[int]:
        """Rows of a frame's sweeps: the first n connected vehicles, then the road-side unit."""
        if n_vehicles > scene.n_connected:
            raise ValueError(
                f"n_vehicles = {n_vehicles}, but scene {scene.name!r} holds only {scene.n_connected} connected "
                "vehicles; lower n_vehicles or choose other scenes"
            )
        if rsu and scene.rsu is None:
            raise ValueError(f"scene {scene.name!r} has no road-side unit; use rsu=False or choose other scenes")
        return [*range(n_vehicles), *([scene.n_connected] if rsu else [])]

    def _poses(self, scene: Scene, agents: list[int]) -> Float[np.ndarray, "T N 3"]:
        """ego_T_sender: grid frames are parallel to the world's and on one lattice: a shift by whole cells."""
        sensors = scene.pose[:, scene.connected, :2]
        if scene.rsu is not None:
            mast = np.broadcast_to(scene.rsu[:2], (scene.n_frames, 1, 2))
            sensors = np.concatenate([sensors, mast], axis=1)
        shift = grid_origin(sensors[:, agents]) - grid_origin(sensors[:, :1])
        return np.concatenate([shift, np.zeros_like(shift[..., :1])], axis=-1).astype(np.float32)

    def _path(self, scene: Scene, kind: str, agent: int) -> Path:
        return self.root / scene.name / f"{kind}-{agent}.npy"

    def _open(self, scene: Scene, kind: str, agent: int) -> Float[np.ndarray, "T C H W"]:
        path = self._path(scene, kind, agent)
        shape = (scene.n_frames, self.detector.channels, self.detector.size, self.detector.size)
        try:
            maps: np.ndarray = np.load(
                path, mmap_mode="c", allow_pickle=False
            )  # torch wants it writable; "c" writes nowhere
            if maps.shape != shape or maps.dtype != np.float16:
                raise ValueError(f"it holds {maps.dtype} {maps.shape}, not float16 {shape}")
        except (ValueError, OSError, EOFError) as error:
            raise ValueError(f"broken cache file {path}: {error}; delete it, it will be made again") from error
        return maps

    def _ensure(self, scene: Scene, agents: list[int]) -> None:
        """Encode and warp the maps of the agents that have no files yet."""
        missing = [a for a in agents if not self._path(scene, "received", a).exists()]
        if not missing:
            return
        detector = self.detector
        shape = (scene.n_frames, detector.channels, detector.size, detector.size)
        made = {(kind, a): np.empty(shape, np.float16) for kind in ("features", "received") for a in missing}
        ego_context: list[Tensor] = []
        poses = torch.from_numpy(self._poses(scene, missing if 0 in missing else [0, *missing])[:, -len(missing) :])
        starts = range(0, scene.n_frames, CHUNK)
        for start in tqdm(starts, f"encoding {scene.name}", leave=False, disable=not self.progress, unit_scale=CHUNK):
            frames = range(start, min(start + CHUNK, scene.n_frames))
            sweeps = self.source.sweeps(scene, frames)
            with torch.inference_mode():
                flat = detector.encode([sweeps[f][a] for f in range(len(frames)) for a in missing])
                maps = flat.reshape(len(frames), len(missing), *flat.shape[1:])
                warped = detector.warp(maps, poses[frames.start : frames.stop].to(maps.device))
                if isinstance(detector, UsesEgoSweep):
                    ego_context.append(detector.ego_context([of_all[0] for of_all in sweeps]).cpu())
            for column, agent in enumerate(missing):
                made["features", agent][frames.start : frames.stop] = maps[:, column].cpu().numpy()
                made["received", agent][frames.start : frames.stop] = warped[:, column].cpu().numpy()
        if ego_context:
            self._write(self._path(scene, "kept", 0), torch.cat(ego_context).numpy())
        for (kind, agent), array in made.items():  # "features" first: its presence is implied by "received"
            self._write(self._path(scene, kind, agent), array)

    def _write(self, path: Path, array: np.ndarray) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        draft = path.with_name(f".{path.stem}-{uuid.uuid4().hex}.npy")
        np.save(draft, array, allow_pickle=False)
        draft.replace(path)

    def _clean(
        self,
        scene: Scene,
        received: tuple[np.ndarray, ...],
        coverage: Float[Tensor, "T N H W"],
        ego_context: Shaped[np.ndarray, "T ..."] | None,
    ) -> tuple[Dense, tuple[View, ...]]:
        """The ego's output and view of every frame without an attack."""
        device = self.detector.device
        first = torch.zeros(1, dtype=torch.long, device=device)
        everyone = torch.ones(1, len(received), dtype=torch.bool, device=device)
        group, views, logits, boxes = frozenset(range(len(received))), [], [], []
        for t in range(scene.n_frames):
            maps = torch.stack([torch.from_numpy(m[t]) for m in received]).float()[None]
            detector = with_ego_context(
                self.detector, None if ego_context is None else torch.from_numpy(ego_context[t : t + 1])
            )
            with torch.inference_mode():
                dense = detector.perceive(maps.to(device), coverage[t : t + 1].to(device), first, everyone)
                views += make_views(self.detector, dense, [group], [t], [ego_place(scene, t)])
            logits.append(dense.logits.half().cpu())
            boxes.append(dense.boxes.half().cpu())
        return Dense(torch.cat(logits).clone(), torch.cat(boxes).clone()), tuple(views)


def _drop(folder: Path, owner: int) -> None:
    """Delete a folder, unless a fork of the process that owns it calls."""
    if os.getpid() == owner:
        shutil.rmtree(folder, ignore_errors=True)
