"""The folder of encoded scenes: what lies in it, how to bound and to clear it.

    <folder>/<key>/about.json               the scene source and the detector that the key stands for
    <folder>/<key>/<scene>/*.maps           frames, see `block_file`; the folder's time is the scene's last use
    <folder>/<key>/endless-*/<scene>/…      of one process, for a source without end

Only files that the library wrote are ever deleted, whatever else lies there.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from cp_env.paths import cache_directory
from cp_env.world.block_file import DRAFT, SUFFIX

ABOUT = "about.json"
ENDLESS = "endless-"
INDICES = ("v2x-sim", "v2x-sim-det")
"""Folders beside the encoded scenes: indices of data sets."""

STALE = 600.0
"""Seconds after which a draft, written in a fraction of one, belongs to a process that was killed."""

ABANDONED = 86400.0
"""Seconds without a new frame after which a folder of scenes without end is taken for a killed process's."""


@dataclass(frozen=True)
class StoredScene:
    """The encoded frames of one scene."""

    folder: Path
    key: Path  # the folder of its source and detector
    source: str
    detector: str
    bytes: int
    used: float  # seconds since the epoch

    @property
    def name(self) -> str:
        """Of the scene, as the folder is called."""
        return self.folder.name


def encoded_folder() -> Path:
    """Where encoded scenes lie unless a bank is given another place."""
    return cache_directory() / "encoded"


def write_about(folder: Path, source: str, detector: str) -> None:
    """Say in words what a key stands for, unless that is said."""
    if not (folder / ABOUT).exists():
        folder.mkdir(parents=True, exist_ok=True)
        (folder / ABOUT).write_text(json.dumps({"source": source, "detector": detector}))


def stored_scenes(folder: Path) -> list[StoredScene]:
    """The scenes of all sources and detectors, the one used last at the end."""
    found = []
    for place in _scene_folders(folder):
        with contextlib.suppress(FileNotFoundError):  # another process may clear the cache meanwhile
            key = folder / place.relative_to(folder).parts[0]
            source, detector = _about(key)
            size = sum(file.stat().st_size for file in place.iterdir())
            found.append(StoredScene(place, key, source, detector, size, place.stat().st_mtime))
    return sorted(found, key=lambda scene: (scene.used, scene.folder))


def bound(folder: Path, limit: int, keep: Path | None = None) -> int:
    """Delete whole scenes, the one least recently used first, until they take at most `limit` bytes.

    Args:
        folder: of encoded scenes.
        limit: bytes.
        keep: the folder of a scene that stays in any case.

    Returns:
        The bytes that are left.
    """
    scenes = stored_scenes(folder)
    total = sum(scene.bytes for scene in scenes)
    for scene in scenes:
        if total <= limit:
            break
        if scene.folder != keep:
            delete(scene.folder)
            total -= scene.bytes
    return total


def clear(cache: Path) -> int:
    """Delete encoded scenes, those of earlier versions and indices of data sets. Returns the bytes that are free."""
    places = [cache / "encoded", *(cache / name for name in INDICES), *earlier_versions(cache)]
    return sum(delete(place) for place in places)


def sweep(folder: Path) -> None:
    """Delete what killed processes left: drafts, and folders of scenes without end that nobody adds to."""
    now = time.time()
    for draft in folder.rglob(f"{DRAFT}*"):
        with contextlib.suppress(OSError):
            if now - draft.stat().st_mtime > STALE:
                draft.unlink()
    for place in folder.rglob(f"{ENDLESS}*"):
        with contextlib.suppress(OSError):
            if now - max(path.stat().st_mtime for path in (place, *place.iterdir())) > ABANDONED:
                delete(place)


def earlier_versions(cache: Path) -> list[Path]:
    """Folders of maps in the layout of version 0.1, one file a vehicle and kind, which nothing reads any more."""
    folders = (path for path in _folders(cache) if re.fullmatch(r".+-[0-9a-f]{16}", path.name))
    return [path for path in folders if next(path.glob("*/received-*.npy"), None) is not None]


def size(folder: Path) -> int:
    """Bytes of the library's files under a folder."""
    total = 0
    for path in _files(folder):
        with contextlib.suppress(FileNotFoundError):
            total += path.stat().st_size
    return total


def delete(folder: Path) -> int:
    """Delete the library's files under a folder, and the folders that are empty then. Returns their bytes."""
    freed = 0
    for path in _files(folder):
        with contextlib.suppress(OSError):
            held = path.stat().st_size
            path.unlink()
            freed += held
    for base, _, _ in os.walk(folder, topdown=False):
        with contextlib.suppress(OSError):
            Path(base).rmdir()
    return freed


def _files(folder: Path) -> Iterator[Path]:
    """What the library wrote under a folder."""
    for base, _, names in os.walk(folder):
        for name in names:
            if name.startswith(DRAFT) or name.endswith((SUFFIX, ".npz", ".npy")) or name in (ABOUT, "index.json"):
                yield Path(base, name)


def _scene_folders(folder: Path) -> Iterator[Path]:
    for key in _folders(folder):
        for place in _folders(key):
            if place.name.startswith(ENDLESS):
                yield from _folders(place)
            else:
                yield place


def _folders(folder: Path) -> list[Path]:
    with contextlib.suppress(FileNotFoundError, NotADirectoryError):
        return [path for path in folder.iterdir() if path.is_dir()]
    return []


def _about(key: Path) -> tuple[str, str]:
    """The source and detector of a key; question marks where the file that says so is missing or broken."""
    try:
        about = json.loads((key / ABOUT).read_text())
        return str(about["source"]), str(about["detector"])
    except (OSError, ValueError, KeyError, TypeError):
        return "?", "?"
