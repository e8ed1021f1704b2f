"""Digests of the source files that a defender, an attack or a detector rests on: stored runs are known by them.

A class that ships rests on the folder of its family, weights and tables included. A class of yours rests on its own
file and on the files that it imports of its own package, or beside itself. Files are read for that, not run. What an
option names counts, too, if it is a file.
"""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Iterator, Sequence
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Literal

from defenders.calibration import own_file
from defenders.registry import Spec

Family = Literal["defender", "attack", "detector"]

HOMES: dict[str, tuple[str, tuple[str, ...]]] = {
    "defender": ("defenders", ("",)),
    "attack": ("agents", ("attacks", "learning")),
    "detector": ("cp_env", ("detector",)),
}
"""Of each family, the package that ships it and its folders there."""

SUFFIXES = (".json", ".npz", ".py", ".safetensors")
_SHIPPED = frozenset(package for package, _ in HOMES.values())


@lru_cache
def code_of(family: Family, spec: str) -> str:
    """Digest of the files that an entry rests on; "" if there are none (a class that was typed in).

    Args:
        family: which family `spec` names a member of.
        spec: a name or "module:Class", with options or without.

    Returns:
        16 hexadecimal digits. It is worked out once a process: what runs is what was there when it was imported.
    """
    parsed = Spec.parse(spec)
    files = list(_own(parsed.place[0]) if parsed.place else _shipped(family))
    files += [path for value in parsed.options.values() if (path := _file(value)) is not None]
    if not files:
        return ""
    sha = hashlib.sha256()
    for path in files:
        sha.update(f"{path.name}\0{hashlib.sha256(path.read_bytes()).hexdigest()}\0".encode())
    return sha.hexdigest()[:16]


def calibration_digest(detector: str) -> str:
    """Digest of the user's calibration of the detector with this digest; "" if there is none."""
    path = own_file(detector)
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16] if detector and path.is_file() else ""


@lru_cache
def _shipped(family: str) -> Sequence[Path]:
    """The files of the folders that ship a family."""
    package, folders = HOMES[family]
    origin = _origin(package)
    if origin is None:
        return ()
    found = (path for folder in folders for path in (origin.parent / folder).rglob("*") if path.suffix in SUFFIXES)
    return sorted(path for path in found if path.is_file())


def _own(module: str) -> list[Path]:
    """The file of a module, and those it imports of its own package or, if it is in none, beside itself."""
    origin = _origin(module)
    if origin is None or origin.suffix != ".py":
        return [] if origin is None else [origin]
    words = module.split(".")
    root = origin.parents[len(words) - (0 if origin.name == "__init__.py" else 1)]
    found, todo = {origin}, [(origin, words)]
    while todo:
        path, at = todo.pop()
        for name in _imports(path, at):
            for file in _files(root, name, own=words[0], alone=len(words) == 1):
                if file not in found:
                    found.add(file)
                    todo.append((file, name.split(".")))
    return sorted(found)


def _files(root: Path, name: str, *, own: str, alone: bool) -> Iterator[Path]:
    """The files of a module of that name, if it belongs to whoever imports it."""
    top, *rest = name.split(".")
    place = root.joinpath(top, *rest)
    if top == own or (alone and not rest and top not in _SHIPPED):
        yield from (path for path in (place.with_suffix(".py"), place / "__init__.py") if path.is_file())


def _imports(path: Path, at: Sequence[str]) -> Iterator[str]:
    """Names of the modules that a file imports; of `from a import b` both `a` and `a.b`."""
    try:
        tree = ast.parse(path.read_bytes())
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return
    package = list(at) if path.name == "__init__.py" else list(at[:-1])
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            name = ".".join([*base, *filter(None, [node.module])])
            yield from filter(None, [name, *(f"{name}.{alias.name}".lstrip(".") for alias in node.names)])


def _origin(module: str) -> Path | None:
    """The file of a module, without importing it; its packages are imported, as they are when it is played."""
    try:
        found = find_spec(module)
    except (ImportError, ValueError, AttributeError):
        return None
    if found is None or not found.has_location or not found.origin:
        return None
    path = Path(found.origin)
    return path.resolve() if path.is_file() else None


def _file(value: str) -> Path | None:
    """The file that an option's value names."""
    try:
        path = Path(value)
        return path if path.is_file() else None
    except (OSError, ValueError):
        return None
