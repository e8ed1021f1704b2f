"""The shared maps of every vehicle and frame: read from memory or disk, encoded when they are first asked for.

A block of `BLOCK` frames is encoded at once, counted from the scene's beginning, and the frames of one vehicle are one
batch of the encoder. So a frame has the same bits whichever frame was asked for first, and however many vehicles.
"""

from __future__ import annotations

import contextlib
import os
import sys
import uuid
import warnings
import weakref
from collections import OrderedDict
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
import torch
from jaxtyping import Float16, Shaped
from tqdm import tqdm

from cp_env.detector.protocol import DetectorLike, UsesEgoSweep
from cp_env.paths import cache_limit, room_in_memory
from cp_env.scenes.errors import BrokenData
from cp_env.types import Endless, Scene, SceneSource, Sweep
from cp_env.world import cache_folder
from cp_env.world.block_file import SUFFIX, read_chunk, write_block
from cp_env.world.packing import pack_array, pack_map, unpack_array, unpack_map

BLOCK = 5
"""Frames encoded together: few, because the first of them is waited for; a longer block is hardly faster a frame."""

MEMORY = room_in_memory()
"""Bytes of maps that stay unpacked in memory. A hundred frames of five vehicles take 131 MB."""

UNSEEN = 50 * 10**6
"""Bytes that may be written before the folder's size is looked at again: by so much a process may exceed the bound."""

CONTEXT = "context"


class MapStore:
    """Maps and ego contexts of one source under one detector.

    Args:
        source: of scenes and sweeps.
        detector: whose encoder makes the maps.
        folder: of encoded scenes; every source and detector has a folder of its own in it.
        key: the name of that folder.
        progress: whether to say on standard error, once, that frames are encoded and where they are kept.

    Raises:
        ValueError: the environment variable `CP_ENV_CACHE_SIZE` is no size.
    """

    def __init__(self, source: SceneSource, detector: DetectorLike, folder: Path, key: str, progress: bool) -> None:
        self.source, self.detector, self.folder, self.progress = source, detector, folder, progress
        self.root = folder / key
        if isinstance(source, Endless) and source.endless:  # a folder of our own, which goes with us
            self.root /= f"{cache_folder.ENDLESS}{uuid.uuid4().hex}"
            weakref.finalize(self, drop, self.root, os.getpid())
        self._key, self._limit, self._room = key, cache_limit(), 0
        self._begun = False
        self._named: set[Path] = set()  # files and folders of which was warned
        self._memory: OrderedDict[tuple[str, str, int], np.ndarray] = OrderedDict()
        self._held = 0

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_memory": OrderedDict(), "_held": 0}

    def maps(self, scene: Scene, agents: Sequence[int], frame: int) -> list[Float16[np.ndarray, "C H W"]]:
        """What each agent (row of a frame's sweeps) encodes, in its own grid frame."""
        return self._read(scene, [_item(agent) for agent in agents], frame)

    def ego_context(self, scene: Scene, frame: int) -> Shaped[np.ndarray, "..."]:
        """What the ego keeps of its own sweep."""
        return self._read(scene, [CONTEXT], frame)[0]

    def touch(self, scene: Scene) -> None:
        """Note that the scene is used now: the bound of the cache deletes others first."""
        with contextlib.suppress(OSError):
            os.utime(self.place(scene))

    def place(self, scene: Scene) -> Path:
        """The folder of a scene."""
        name = quote(scene.name, safe=" ")
        return self.root / (f"%2E{name[1:]}" if name.startswith(".") else name)

    def _read(self, scene: Scene, items: Sequence[str], frame: int) -> list[np.ndarray]:
        found = {item: self._recall(scene, item, frame) for item in items}
        missing = [item for item, array in found.items() if array is None]
        if missing:
            found.update(self._encode(scene, missing, frame))
        return [array for array in map(found.get, items) if array is not None]

    # -- memory and disk -----------------------------------------------------------------------------------------

    def _recall(self, scene: Scene, item: str, frame: int) -> np.ndarray | None:
        """An item of a frame from memory or disk; None if it is in neither, or broken."""
        key = (scene.name, item, frame)
        if key in self._memory:
            self._memory.move_to_end(key)
            return self._memory[key]
        block = _block(scene, frame)
        path = self._path(scene, item, block)
        try:
            chunk = read_chunk(path, frame - block.start, len(block))
            array = self._unpack(path, item, chunk)
        except (FileNotFoundError, NotADirectoryError):
            return None
        except (BrokenData, OSError) as error:
            self._warn(path, f"broken file in the scene cache, which is made again: {error}")
            return None
        self._remember(key, array)
        return array

    def _unpack(self, path: Path, item: str, chunk: bytes) -> np.ndarray:
        try:
            return unpack_array(chunk) if item == CONTEXT else unpack_map(chunk, self._shape)
        except ValueError as error:
            raise BrokenData(path, str(error)) from error

    def _remember(self, key: tuple[str, str, int], array: np.ndarray) -> None:
        before = self._memory.pop(key, None)
        self._memory[key] = array
        self._held += array.nbytes - (0 if before is None else before.nbytes)
        while self._held > MEMORY:
            self._held -= self._memory.popitem(last=False)[1].nbytes

    def _write(self, scene: Scene, item: str, block: range, chunks: list[bytes]) -> None:
        """Keep a block on disk; a warning if that cannot be."""
        path = self._path(scene, item, block)
        try:
            self._begin()
            self._room -= write_block(path, chunks)
            if self._limit is not None and self._room < 0:
                left = cache_folder.bound(self.folder, self._limit, keep=path.parent)
                self._room = min(max(self._limit - left, 0), UNSEEN)
        except OSError as error:
            text = f"the scene cache cannot be written ({error}): frames are encoded again when they leave memory"
            self._warn(self.root, f"{text}; set CP_ENV_CACHE to a folder with room")

    def _warn(self, path: Path, text: str) -> None:
        """Warn, once for each path."""
        if path not in self._named:
            self._named.add(path)
            warnings.warn(text, stacklevel=2)

    def _begin(self) -> None:
        """Before frames are written: clear away after killed processes, once, and say what the folder holds."""
        if not self._begun:
            self._begun = True
            cache_folder.sweep(self.folder / self._key)
        cache_folder.write_about(self.folder / self._key, self.source.name, type(self.detector).__name__)

    def _path(self, scene: Scene, item: str, block: range) -> Path:
        return self.place(scene) / f"{item}-{block.start}{SUFFIX}"

    # -- encoding ------------------------------------------------------------------------------------------------

    @property
    def _shape(self) -> tuple[int, int, int]:
        return (self.detector.channels, self.detector.size, self.detector.size)

    def _encode(self, scene: Scene, items: Sequence[str], frame: int) -> dict[str, np.ndarray]:
        """Encode the items for the frame's whole block, and keep it."""
        if self.progress and not self._begun:
            text = f"encoding frames when they are first played; they are kept in {self.root} (see: cp-env cache)"
            tqdm.write(text, file=sys.stderr)
        block, made = _block(scene, frame), {}
        sweeps = self.source.sweeps(scene, block)
        for item in items:
            if item == CONTEXT:
                arrays = self._contexts([of_all[0] for of_all in sweeps])
                chunks = [pack_array(array) for array in arrays]
            else:
                arrays = self._maps([of_all[_agent(item)] for of_all in sweeps])
                chunks = [pack_map(array) for array in arrays]
            self._write(scene, item, block, chunks)
            for t, array in zip(block, arrays, strict=True):
                self._remember((scene.name, item, t), array)
            made[item] = arrays[frame - block.start]
        return made

    def _maps(self, sweeps: list[Sweep]) -> list[Float16[np.ndarray, "C H W"]]:
        with torch.inference_mode():
            maps = self.detector.encode(sweeps).to(torch.float16).cpu().numpy()
        if maps.shape != (len(sweeps), *self._shape):
            raise ValueError(
                f"encode must give maps of [{len(sweeps)}, channels, size, size] = {(len(sweeps), *self._shape)}, "
                f"not {maps.shape}; mend the detector's `channels` and `size`, or its `encode`"
            )
        return [one.copy() for one in maps]  # each leaves memory by itself

    def _contexts(self, sweeps: list[Sweep]) -> list[Shaped[np.ndarray, "..."]]:
        assert isinstance(self.detector, UsesEgoSweep)
        with torch.inference_mode():
            return [np.array(one) for one in self.detector.ego_context(sweeps).cpu().numpy()]


def drop(folder: Path, owner: int) -> None:
    """Delete a folder of encoded scenes, unless a fork of the process that owns it calls."""
    if os.getpid() == owner:
        cache_folder.delete(folder)


def _block(scene: Scene, frame: int) -> range:
    """The frames that are encoded together with one."""
    start = frame // BLOCK * BLOCK
    return range(start, min(start + BLOCK, scene.n_frames))


def _item(agent: int) -> str:
    return f"map-{agent}"


def _agent(item: str) -> int:
    return int(item.removeprefix("map-"))
