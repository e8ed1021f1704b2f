"""XML files, plain or packed by gzip: parsed whole, or read element by element in bounded memory."""

from __future__ import annotations

import gzip
import xml.etree.ElementTree as ET
import zlib
from collections.abc import Iterator
from io import BufferedIOBase
from pathlib import Path
from typing import cast

from cp_env.scenes.errors import BrokenData

LARGEST = 16 * 2**20
"""Bytes of the largest element that `children` reads."""

_CHUNK = 2**16


def parse(path: Path) -> ET.Element:
    """The root of an XML file.

    Args:
        path: of the file; packed by gzip if its name ends in `.gz`.

    Returns:
        The root, with all that is in it.

    Raises:
        BrokenData: the file is missing or no XML.
    """
    try:
        with _opened(path) as file:
            return ET.parse(file).getroot()
    except (OSError, ET.ParseError, EOFError, zlib.error) as error:
        raise _broken(path, error) from error


def children(path: Path) -> Iterator[ET.Element]:
    """The children of the root one after another; each is forgotten when the next is asked for.

    Args:
        path: of the file; packed by gzip if its name ends in `.gz`.

    Yields:
        A child of the root, with all that is in it.

    Raises:
        BrokenData: the file is missing or no XML, or one child is larger than `LARGEST`.
    """
    parser: ET.XMLPullParser[ET.Element] = ET.XMLPullParser(("start", "end"))
    depth = held = 0
    root: ET.Element | None = None
    try:
        with _opened(path) as file:
            while chunk := file.read(_CHUNK):
                parser.feed(chunk)
                held += len(chunk)
                for event, element in cast("Iterator[tuple[str, ET.Element]]", parser.read_events()):
                    if event == "start":
                        root = element if root is None else root
                        depth += 1
                        continue
                    depth -= 1
                    if depth == 1 and root is not None:
                        yield element
                        root.clear()
                        held = 0
                if held > LARGEST:
                    raise BrokenData(path, f"holds an element of more than {LARGEST // 2**20} MiB")
            parser.close()
    except (OSError, ET.ParseError, EOFError, zlib.error) as error:
        raise _broken(path, error) from error


def _opened(path: Path) -> BufferedIOBase:
    return gzip.open(path) if path.suffix == ".gz" else path.open("rb")


def _broken(path: Path, error: Exception) -> BrokenData:
    if isinstance(error, OSError) and not isinstance(error, gzip.BadGzipFile):
        return BrokenData(path, f"cannot be read: {error.strerror or error}")
    return BrokenData(path, f"is no XML: {error}")
