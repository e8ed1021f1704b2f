"""Errors of broken data: the file, the reason, and the scenes left out because of it."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from cp_env.progress import say

T = TypeVar("T")


class BrokenData(ValueError):
    """A file of a data set that is missing, cut short, or says what cannot be.

    Attributes:
        file: the file at fault.
        reason: what is wrong with it, in words.
    """

    def __init__(self, file: Path | str, reason: str) -> None:
        self.file, self.reason = Path(file), reason
        super().__init__(f"{self.file}: {reason}")

    def __reduce__(self) -> tuple[type[BrokenData], tuple[Path, str]]:
        return type(self), (self.file, self.reason)  # it crosses process borders


@dataclass(frozen=True)
class LeftOut:
    """A scene that was left out, the file at fault and the reason."""

    scene: str
    file: Path
    reason: str

    def __str__(self) -> str:
        return f"left out scene {self.scene}: {self.file}: {self.reason}"


def sift(
    names: Iterable[str], check: Callable[[str], object], *, skip_broken: bool
) -> tuple[tuple[str, ...], tuple[LeftOut, ...]]:
    """The scenes for which `check(name)` raises no `BrokenData`, and those left out because it does.

    Each scene left out is printed. The unit is the scene: frames must follow each other at one rate.

    Raises:
        BrokenData: the first one met, unless `skip_broken`.
        ValueError: every scene is broken.
    """
    kept: list[str] = []
    left_out: list[LeftOut] = []
    for name in names:
        try:
            check(name)
        except BrokenData as error:
            if not skip_broken:
                raise BrokenData(
                    error.file, f"{error.reason} (scene {name}; mend it, or leave such scenes out with skip_broken)"
                ) from error
            left_out.append(LeftOut(name, error.file, error.reason))
            say(str(left_out[-1]), sys.stdout)
        else:
            kept.append(name)
    if left_out and not kept:
        raise ValueError(f"every scene is broken; the first: {left_out[0]}")
    return tuple(kept), tuple(left_out)
