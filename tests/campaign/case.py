"""A case of the campaign: one claim that is put to the test, and what came of it."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

Figures = Mapping[str, Any]
"""Numbers and short texts by name, fit for JSON."""


class Fault(AssertionError):
    """The claim does not hold."""


@dataclass(frozen=True)
class Case:
    """One thing to try.

    Attributes:
        part: which part of the campaign it belongs to.
        name: distinct in its part; it holds all that the case depends on, sizes and seeds included.
        play: tries it in an empty folder, and returns what was counted or measured; `Fault` if the claim does not hold.
    """

    part: str
    name: str
    play: Callable[[Path], Figures]


@dataclass(frozen=True)
class Result:
    """What came of a case. `code` is the digest of the tree's source files that were tried."""

    part: str
    name: str
    holds: bool
    seconds: float
    code: str
    figures: dict[str, Any] = field(default_factory=dict)
    why: str = ""


def try_case(case: Case, folder: Path, code: str) -> Result:
    """Play a case in a folder that is made; whatever it raises is a result."""
    begin = time.monotonic()
    folder.mkdir(parents=True)
    holds, figures, why = True, dict[str, Any](), ""
    try:
        figures = dict(case.play(folder))
    except Fault as error:
        holds, why = False, str(error)
    except Exception:
        holds, why = False, traceback.format_exc(limit=-6)
    return Result(case.part, case.name, holds, round(time.monotonic() - begin, 1), code, figures, why[-4000:])
