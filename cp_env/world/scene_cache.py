"""The episodes of a scene source under a detector: poses, maps, clean outputs and truth, computed as they are played.

Maps are kept in the user's cache directory (see `map_store`) under a hash over the scene source and what the detector's
maps depend on (`maps_digest`). So a stale entry cannot be read, and detectors that fuse the same maps in different ways
share theirs. Deleting the directory, at any time, loses nothing but time; a file that is broken is named and made anew.
The environment variable `CP_ENV_CACHE` moves the cache, `CP_ENV_CACHE_SIZE` bounds it.
"""

from __future__ import annotations

import hashlib
import os
from collections import OrderedDict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float

from cp_env.detector.protocol import DetectorLike, UsesEgoSweep, maps_digest
from cp_env.geometry.planar import grid_origin
from cp_env.metrics.ground_truth import truth_boxes
from cp_env.types import Endless, Scene, SceneSource
from cp_env.world.cache_folder import encoded_folder
from cp_env.world.episode import Clean, Episode
from cp_env.world.map_store import BLOCK, MapStore, drop
from cp_env.world.per_frame import PerFrame
from cp_env.world.unattacked import Unattacked

KEPT = 64
"""Episodes whose clean views stay in memory; a hundred frames take about 8 MB."""

LAYOUT = 1
"""Version of what the files under a key hold."""


class SceneBank:
    """Episodes of one source under one detector.

    A source with an attribute `endless` that is true gives scenes that hardly come back: their files are this bank's
    alone, and leave the disk when they leave memory (after `KEPT` others), at the latest with bank and episodes.

    Args:
        source: of scenes and sweeps.
        detector: the victim.
        root: folder of encoded scenes; in the user's cache directory by default.
        progress: whether to say on standard error that scenes are encoded, and where they are kept.

    Raises:
        ValueError: a scene holds fewer connected vehicles than asked for, or lacks a road-side unit that is; or the
            environment variable `CP_ENV_CACHE_SIZE` is no size.
    """

    def __init__(
        self, source: SceneSource, detector: DetectorLike, root: Path | None = None, progress: bool = True
    ) -> None:
        self.source, self.detector = source, detector
        self.endless = isinstance(source, Endless) and source.endless
        self.store = MapStore(source, detector, root or encoded_folder(), _key(source, detector), progress)
        self._episodes: OrderedDict[tuple[str, int, bool], Episode] = OrderedDict()

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_episodes": OrderedDict()}

    @property
    def root(self) -> Path:
        """The folder of this source and detector."""
        return self.store.root

    def episode(self, name: str, n_vehicles: int, rsu: bool) -> Episode:
        """The episode of scene `name`. Its frames are encoded when they are first asked for."""
        key = (name, n_vehicles, rsu)
        if key not in self._episodes:
            self._episodes[key] = self._build(name, n_vehicles, rsu)
        self._episodes.move_to_end(key)
        while len(self._episodes) > KEPT:
            _, left = self._episodes.popitem(last=False)
            if self.endless:
                drop(self.store.place(left.scene), os.getpid())
        return self._episodes[key]

    def check(self, n_vehicles: int, rsu: bool) -> None:
        """Look at scenes until one suits, mostly the first, so that what none has is refused before a reset.

        A source without end is left alone: to make a scene takes it seconds.

        Raises:
            ValueError: no scene has so many connected vehicles, or none a road-side unit if one is asked for.
        """
        first: ValueError | None = None
        for name in () if self.endless else self.source.names():
            try:
                _agents(self.source.load(name), n_vehicles, rsu)
            except ValueError as error:
                first = first or error
            else:
                return
        if first is not None:
            raise first

    def _build(self, name: str, n_vehicles: int, rsu: bool) -> Episode:
        scene, store = self.source.load(name), self.store
        agents, n_frames = _agents(scene, n_vehicles, rsu), scene.n_frames
        poses = torch.from_numpy(_poses(scene, agents))
        coverage = self.detector.coverage(poses)
        uses_sweep = isinstance(self.detector, UsesEgoSweep)
        context = PerFrame(n_frames, partial(store.ego_context, scene), keep=False) if uses_sweep else None
        unattacked = Unattacked(store, scene, agents, poses, coverage, context)
        ego, extent = int(scene.connected[0]), self.detector.extent
        truth = PerFrame(n_frames, lambda t: truth_boxes(scene, t, ego, extent))
        found = PerFrame(n_frames, lambda t: unattacked.witnesses(t, truth[t]))
        store.touch(scene)
        clean = Clean(PerFrame(n_frames, unattacked.frame))
        return Episode(scene, store, agents, poses, coverage, clean, truth, context, found)


def _key(source: SceneSource, detector: DetectorLike) -> str:
    """Names what the maps of a source under a detector depend on: their last bits on the kind of device, too."""
    parts = (LAYOUT, BLOCK, source.digest, maps_digest(detector), detector.device.type)
    return hashlib.sha256(repr(parts).encode()).hexdigest()[:24]


def _agents(scene: Scene, n_vehicles: int, rsu: bool) -> tuple[int, ...]:
    """Rows of a frame's sweeps: the first n connected vehicles, then the road-side unit."""
    if n_vehicles > scene.n_connected:
        way = "lower n_vehicles or choose other scenes"
        if scene.n_connected < 2:
            unit = "take n_vehicles=1 with rsu=True, or " if scene.rsu is not None else ""
            way = f"{unit}choose other scenes"
        raise ValueError(
            f"n_vehicles = {n_vehicles}, but scene {scene.name!r} holds only {scene.n_connected} connected "
            f"vehicle{'' if scene.n_connected == 1 else 's'}; {way}"
        )
    if rsu and scene.rsu is None:
        raise ValueError(f"scene {scene.name!r} has no road-side unit; use rsu=False or choose other scenes")
    return (*range(n_vehicles), *([scene.n_connected] if rsu else []))


def _poses(scene: Scene, agents: tuple[int, ...]) -> Float[np.ndarray, "T N 3"]:
    """ego_T_sender: grid frames are parallel to the world's and on one lattice: a shift by whole cells."""
    sensors = scene.pose[:, scene.connected, :2]
    if scene.rsu is not None:
        mast = np.broadcast_to(scene.rsu[:2], (scene.n_frames, 1, 2))
        sensors = np.concatenate([sensors, mast], axis=1)
    shift = grid_origin(sensors[:, agents]) - grid_origin(sensors[:, :1])
    return np.concatenate([shift, np.zeros_like(shift[..., :1])], axis=-1).astype(np.float32)
