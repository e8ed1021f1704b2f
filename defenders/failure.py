"""What is reported of an exception in a plug-in: its text, file and line, and the traceback from the plug-in's code on.

An exception may have a text that cannot be made, of any length, or with characters that steer a terminal. Reporting it
raises nothing all the same.
"""

from __future__ import annotations

import sysconfig
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from traceback import FrameSummary, StackSummary, extract_tb
from types import GeneratorType
from typing import Any

ROOT = Path(__file__).absolute().parents[1]
OURS = tuple(ROOT / package for package in ("agents", "cp_env", "defenders"))
"""Folders whose frames come before those of a plug-in: what calls it."""

LIBRARIES = ("beartype", "gymnasium", "jaxtyping", "numpy", "pettingzoo", "ray", "scipy", "torch")
"""Packages that may stand between our code and a plug-in's, or be called by it."""

STANDARD = Path(sysconfig.get_path("stdlib"))
"""Where Python's own modules are."""

MAX_REASON = 1000
"""Characters of a reason, at most."""

MAX_TRACE = 4000
"""Characters of a traceback, at most: its end is kept."""

MAX_CAUSES = 10
"""Exceptions of a chain that are looked at."""

LAST = 6
"""Frames that are shown of an exception in which no plug-in has a part."""

NOTE = "raised by the "
"""What a note on an exception begins with that names a plug-in: see `blamed`."""


@dataclass(frozen=True)
class Failure:
    """The failure of a call, in the place of its result.

    Attributes:
        reason: kind and text of the exception, in one line; or why there is no result.
        place: "mine.py:12 in act", the innermost line of the plug-in; empty if it is not known.
        trace: the traceback from the plug-in's first frame on, without the exception's text; empty likewise.
        entry: "attack mine:Whisper" or "defender mine:Halves"; empty if it is not known.
        killed: whether the plug-in had a process of its own, which was killed: that may be nobody's mistake.
    """

    reason: str
    place: str = ""
    trace: str = ""
    entry: str = ""
    killed: bool = False

    def __str__(self) -> str:
        return f"{self.reason}, at {self.place}" if self.place else self.reason


class RemoteError(RuntimeError):
    """A plug-in failed in another process; `failure` is what that process told of it."""

    def __init__(self, message: str, failure: Failure | None = None) -> None:
        super().__init__(message)
        self.failure = failure


def failure_of(error: BaseException, asked: object = None) -> Failure:
    """What is reported of an exception.

    Args:
        error: that was caught.
        asked: the generator that waits while our code finds something wrong with what it has yielded.
    """
    try:
        return _failure(error, asked)
    except Exception:  # the exception itself is hostile
        return Failure("an exception that says nothing of itself")


def _failure(error: BaseException, asked: object) -> Failure:
    cause, entry = _origin(error), _entry(error)
    if isinstance(cause, RemoteError):
        theirs = cause.failure or Failure(reason_of(cause))
        reason = theirs.reason if cause is error else reason_of(error)
        return replace(theirs, reason=reason, entry=entry)
    frames = list(extract_tb(cause.__traceback__))
    own = [number for number, frame in enumerate(frames) if _kind(frame) == "plug-in"]
    if own:
        return Failure(reason_of(error), _place(frames[own[-1]]), _text(frames[own[0] :]), entry)
    if place := paused_at(asked):
        return Failure(reason_of(error), place, entry=entry)
    return Failure(reason_of(error), trace=_text(frames[-LAST:]), entry=entry)


def reason_of(error: BaseException) -> str:
    """Kind and text of an exception, in one line of plain characters."""
    try:
        text = str(error)
    except Exception:
        text = "(its text cannot be made)"
    return one_line(f"{type(error).__name__}: {text}")


def one_line(text: str) -> str:
    """A reason: one line of plain characters, with "…" where the rest is left out."""
    line = plain(" ".join(text[: 4 * MAX_REASON].split()))
    return line if len(line) <= MAX_REASON else f"{line[: MAX_REASON - 1]}…"


def plain(text: str) -> str:
    """The text with "?" for each character that does not print, line ends left out."""
    return "".join(c if c.isprintable() or c == "\n" else "?" for c in text)


@contextmanager
def blamed(entry: str, kind: type[Exception] = Exception) -> Iterator[None]:
    """Note on an exception of that kind which plug-in it came from; it is raised on as it is.

    Args:
        entry: "attack mine:Whisper" or "defender mine:Halves".
        kind: of the exceptions.
    """
    try:
        yield
    except kind as error:
        BaseException.add_note(error, f"{NOTE}{entry}")
        raise


def paused_at(generator: object) -> str:
    """Where a plug-in's generator waits, or begins if it has ended; empty for anything else."""
    if not isinstance(generator, GeneratorType):
        return ""
    while isinstance(generator.gi_yieldfrom, GeneratorType):
        generator = generator.gi_yieldfrom
    code, frame = generator.gi_code, generator.gi_frame
    line = code.co_firstlineno if frame is None else frame.f_lineno
    summary = FrameSummary(code.co_filename, line, code.co_name, lookup_line=False)
    return _place(summary) if _kind(summary) == "plug-in" else ""


def _origin(error: BaseException) -> BaseException:
    """The first exception of the chain of causes in which a plug-in has a part; the error itself if there is none."""
    cause: BaseException | None = error
    for _ in range(MAX_CAUSES):
        if cause is None:
            break
        frames = extract_tb(cause.__traceback__)
        if isinstance(cause, RemoteError) or any(_kind(frame) == "plug-in" for frame in frames):
            return cause
        cause = cause.__cause__
    return error


def _kind(frame: FrameSummary) -> str:
    """Whose code a frame is: "ours", a "library", or a "plug-in"."""
    path = Path(frame.filename)
    if frame.filename.startswith("<"):
        return "library"
    if any(path.is_relative_to(folder) for folder in OURS):
        return "ours"
    packages = [number for number, part in enumerate(path.parts) if part in ("site-packages", "dist-packages")]
    if packages:  # a plug-in may be installed, too
        return "library" if Path(path.parts[packages[-1] + 1]).stem in LIBRARIES else "plug-in"
    return "library" if path.is_relative_to(STANDARD) else "plug-in"


def _short(filename: str) -> str:
    """The file from the current folder on, or else its last two parts: no path of the machine."""
    path = Path(filename)
    if not path.is_absolute():
        return filename
    for folder in (Path.cwd(), ROOT):
        if path.is_relative_to(folder):
            return path.relative_to(folder).as_posix()
    return Path(*path.parts[-2:]).as_posix()


def _place(frame: FrameSummary) -> str:
    return plain(f"{_short(frame.filename)}:{frame.lineno} in {frame.name}")


def _text(frames: Sequence[FrameSummary]) -> str:
    """The traceback of these frames."""
    shown = [
        FrameSummary(_short(frame.filename), frame.lineno, frame.name, lookup_line=False, line=frame.line)
        for frame in frames
    ]
    text = plain("".join(StackSummary.from_list(shown).format()).rstrip("\n"))
    return text if len(text) <= MAX_TRACE else f"  …{text[len(text) - MAX_TRACE :]}"


def _entry(error: BaseException) -> str:
    """What `blamed` noted first."""
    notes: Any = getattr(error, "__notes__", ())
    named = [note for note in notes if isinstance(note, str) and note.startswith(NOTE)]
    return plain(named[0].removeprefix(NOTE)) if named else ""
