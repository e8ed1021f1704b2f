"""The tables of a data set in the nuScenes format: JSON lists of flat records, read one record at a time.

The largest table of V2X-Sim is a few hundred megabytes of text; as Python objects it would take gigabytes.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TextIO

from tqdm import tqdm

from cp_env.scenes.errors import BrokenData

TABLES = (
    "scene",
    "sample",
    "sensor",
    "calibrated_sensor",
    "sample_data",
    "ego_pose",
    "category",
    "instance",
    "sample_annotation",
)
"""The tables that are read, each `<name>.json`."""

RECORD_CHARACTERS = 1 << 20
"""One record is at most so long; a table may be of any length, it is read record by record."""

_CHUNK = 1 << 20  # characters
_BETWEEN = " \t\r\n,"


def find_tables(root: Path, version: str | None) -> Path:
    """The folder of tables in `root`: `root/version`, or the only one there is.

    Raises:
        BrokenData: no folder, no table in it, or several to choose from.
    """
    if not root.is_dir():
        raise BrokenData(root, "no such folder; name the one that holds `sweeps` and the folder of tables")
    if version is not None:
        folders = [root / version]
    else:
        folders = sorted(path.parent for path in root.glob("*/sample_data.json"))
    if not folders:
        raise BrokenData(root, "it holds no folder of tables, such as v2.0 with scene.json, sample_data.json, …")
    if len(folders) > 1:
        names = ", ".join(folder.name for folder in folders)
        raise BrokenData(root, f"it holds several folders of tables ({names}); choose one with version=")
    missing = [name for name in TABLES if not (folders[0] / f"{name}.json").is_file()]
    if missing:
        raise BrokenData(folders[0] / f"{missing[0]}.json", "missing table")
    return folders[0]


class Tables:
    """A folder of tables, and a hash over all that was read of them."""

    def __init__(self, folder: Path, progress: bool) -> None:
        self.folder = folder
        total = sum(self.path(name).stat().st_size for name in TABLES)
        self._sha = hashlib.sha256()
        self._bar = tqdm(
            total=total, desc=f"indexing {folder}", unit="B", unit_scale=True, disable=None if progress else True
        )

    def path(self, name: str) -> Path:
        return self.folder / f"{name}.json"

    def read(self, name: str, *fields: str) -> Iterator[list[Any]]:
        """`[record[field] for field in fields]` of every record of a table, in order.

        Raises:
            BrokenData: the table cannot be read, is no list of records, or a record lacks a field, is longer than
            `RECORD_CHARACTERS`, or is nested deeper than Python's decoder goes.
        """
        path = self.path(name)
        for number, record in enumerate(self._records(path)):
            if not isinstance(record, dict):
                raise BrokenData(path, f"record {number} is {record!r:.80}, not a table of fields")
            try:
                yield [record[field] for field in fields]
            except KeyError as error:
                raise BrokenData(path, f"record {number} lacks {error}") from error

    def digest(self) -> str:
        """Of everything read so far; ends the progress bar."""
        self._bar.close()
        return self._sha.hexdigest()

    def _records(self, path: Path) -> Iterator[Any]:
        try:
            with path.open(encoding="utf-8") as file:
                yield from self._parts(path, file)
        except BrokenData:
            raise
        except RecursionError as error:
            raise BrokenData(path, "a record that is nested too deeply") from error
        except (OSError, ValueError) as error:
            raise BrokenData(path, str(error)) from error

    def _parts(self, path: Path, file: TextIO) -> Iterator[Any]:
        decode = json.JSONDecoder().raw_decode
        text, at = self._more(file.read(_CHUNK)).lstrip(), 1
        if not text.startswith("["):
            raise BrokenData(path, "it does not hold a JSON list")
        while True:
            while at < len(text) and text[at] in _BETWEEN:
                at += 1
            if at < len(text) and text[at] == "]":
                return
            try:
                record, at = decode(text, at)
            except json.JSONDecodeError as error:
                if len(text) - at > RECORD_CHARACTERS:
                    reason = f"a record of more than {RECORD_CHARACTERS} characters, or what is not JSON"
                    raise BrokenData(path, reason) from error
                chunk = self._more(file.read(_CHUNK))
                if not chunk:
                    raise BrokenData(path, "it is cut short, or not JSON") from error
                text, at = text[at:] + chunk, 0
            else:
                yield record

    def _more(self, chunk: str) -> str:
        self._sha.update(chunk.encode())
        self._bar.update(len(chunk))
        return chunk
