"""The official splits of DAIR-V2X-C, read from the file that its toolkit has; nothing of it ships here."""

from __future__ import annotations

from pathlib import Path

from cp_env.scenes.errors import BrokenData
from cp_env.scenes.formats.bounded import parse_json, read_bytes
from defenders.registry import unknown

NAME = "cooperative-split-data.json"
WHERE = "github.com/AIR-THU/DAIR-V2X has it in data/split_datas"
SPLIT_BYTES = 16 << 20


def find_split_file(root: Path, named: str | None) -> Path:
    """The file of the splits: as named, or `cooperative-split-data.json` in the set's folder or one of the two above.

    Raises:
        BrokenData: it is not there.
    """
    if named:
        return Path(named)
    for folder in (root, root.resolve().parent, root.resolve().parent.parent):
        if (folder / NAME).is_file():
            return folder / NAME
    raise BrokenData(root / NAME, f"is missing: {WHERE}; put it there, name it with split_file=, or use split=all")


def read_split(file: Path, split: str) -> frozenset[str]:
    """The numbers of the vehicle's frames in a split, without leading zeros.

    Raises:
        BrokenData: the file cannot be read, or is of another kind.
        ValueError: it has no such split.
    """
    try:
        said = parse_json(read_bytes(file, SPLIT_BYTES), limit=SPLIT_BYTES)["cooperative_split"]
        splits = {str(name): numbers for name, numbers in said.items()}
    except OSError as error:
        raise BrokenData(file, f"cannot be read: {error.strerror}") from error
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise BrokenData(file, f"holds no table cooperative_split: {str(error)[:200]}") from error
    if split not in splits:
        raise unknown("split", split, ["all", *splits])
    try:
        return frozenset(plain(str(number)) for number in splits[split])
    except TypeError as error:
        raise BrokenData(file, f"split {split!r} is no list of numbers") from error


def plain(number: str) -> str:
    """A frame's number as it is compared: 000010 and 10 are one frame."""
    return number.lstrip("0") or "0"
