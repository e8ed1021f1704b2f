"""OPV2V's folders, `<scenario>/<agent>/<number>.yaml` and its points, and the runs of frames in them.

An agent's name is a number, a road-side unit's is negative. Files are numbered by time.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path

from cp_env.scenes.errors import BrokenData

POINTS = (".pcd", ".bin")
CLOCK = 13  # digits: longer numbers are times of a clock, in ms, µs (16) or ns (19)
_MOST = 1000  # folders looked into for a hint
_DAIR = {"cooperative", "vehicle-side", "infrastructure-side", "cooperative-vehicle-infrastructure"}


@dataclass(frozen=True)
class Scenario:
    """One folder: agents in the order of OpenCOOD (names sorted as text, the first is the ego), and frames of it."""

    folder: Path
    vehicles: tuple[str, ...]
    rsu: str | None
    numbers: tuple[str, ...]  # of the frames, as written: "000069"
    step: int  # from file to file
    suffix: dict[str, str]  # of each agent's points
    missing: dict[str, BrokenData] = field(default_factory=dict)  # by number: a file that an agent lacks

    @property
    def agents(self) -> tuple[str, ...]:
        return self.vehicles if self.rsu is None else (*self.vehicles, self.rsu)

    def note(self, agent: str, number: str) -> Path:
        return self.folder / agent / f"{number}.yaml"

    def points(self, agent: str, number: str) -> Path:
        return self.folder / agent / f"{number}{self.suffix[agent]}"

    @property
    def by_clock(self) -> bool:
        """Whether files are named by times of a clock."""
        return len(self.numbers[0].lstrip("0")) >= CLOCK

    def without_unit(self) -> Scenario:
        lost = {number: error for number, error in self.missing.items() if error.file.parent.name != self.rsu}
        return replace(self, rsu=None, missing=lost)


def scenarios(root: Path) -> dict[str, Path]:
    """Folders in `root` that hold folders named by numbers with frames in them, by name.

    Raises:
        BrokenData: there is no such folder; the message says where to point instead.
    """
    if not root.is_dir():
        raise BrokenData(root, "is no folder")
    found = {folder.name: folder for folder in _folders(root) if is_scenario(folder)}
    if not found:
        raise BrokenData(root, f"holds no scenario (a folder of numbered agents' folders){_hint(root)}")
    return found


def is_scenario(folder: Path) -> bool:
    """Whether it holds a folder named by a number that holds a frame."""
    return any(_holds_frame(folder / agent) for agent in _agents(folder))


def survey(folder: Path) -> Scenario:
    """The agents and frames of a scenario; of several road-side units the first is kept.

    Frames are those of the ego, and those between its first and its last that another agent has: what an agent lacks of
    them is told in `missing`. A scenario of road-side units alone has no frames.

    Raises:
        BrokenData: the ego has no frame.
    """
    agents = _agents(folder)
    vehicles = tuple(agent for agent in agents if int(agent) >= 0)
    units = [agent for agent in agents if int(agent) < 0]
    if not vehicles:
        return Scenario(folder, (), units[0] if units else None, (), 1, {})
    there = {agent: {file.name for file in (folder / agent).iterdir()} for agent in [*vehicles, *units[:1]]}
    listed = {agent: {name[:-5] for name in names if _is_frame(name)} for agent, names in there.items()}
    own = sorted(listed[vehicles[0]], key=int)
    if not own:
        raise BrokenData(folder / vehicles[0], "holds no frame (a file like 000069.yaml)")
    first, last = int(own[0]), int(own[-1])
    named = {int(number): number for names in listed.values() for number in names if first <= int(number) <= last}
    named |= {int(number): number for number in own}  # 69 and 000069 are one frame; the ego's name counts
    numbers = [named[number] for number in sorted(named)]
    suffix = {agent: _suffix(names) for agent, names in there.items()}
    missing: dict[str, BrokenData] = {}
    for agent, names in there.items():
        for number in numbers:
            for ending in (".yaml", suffix[agent]):
                if number + ending not in names:
                    missing.setdefault(number, BrokenData(folder / agent / f"{number}{ending}", "is missing"))
    return Scenario(folder, vehicles, units[0] if units else None, tuple(numbers), usual_step(own), suffix, missing)


def usual_step(numbers: Iterable[str]) -> int:
    """The most frequent difference of two numbers in turn; of a clock's, the median one. 2 if there is none."""
    named = list(numbers)
    steps = sorted(int(b) - int(a) for a, b in pairwise(named))
    if not steps:
        return 2
    return max(1, steps[len(steps) // 2] if len(named[0].lstrip("0")) >= CLOCK else max(set(steps), key=steps.count))


def runs(scenario: Scenario, stride: int, lost: Iterable[str] = ()) -> list[tuple[str, ...]]:
    """The frames that follow each other at one rate: every `stride`-th file, in pieces between holes.

    A hole is a number that is lost or not there; one that the stride passes over costs nothing. Where numbers leave the
    grid of the step, counting begins anew.

    Args:
        scenario: its numbers and their step.
        stride: every so many files are a frame.
        lost: numbers that cannot be read.

    Returns:
        The numbers of each piece.
    """
    gone = set(lost)
    pieces: list[list[str]] = []
    place, expected = 0, -1
    before: int | None = None
    for number in scenario.numbers:
        gap = 0 if before is None else int(number) - before
        before = int(number)
        steps = round(gap / scenario.step) if scenario.by_clock else gap // scenario.step
        if not scenario.by_clock and gap % scenario.step:
            place, expected = 0, -1
        else:
            place += max(steps, 1) if gap else 0
        if place % stride or number in gone:
            continue
        if place != expected:
            pieces.append([])
        pieces[-1].append(number)
        expected = place + stride
    return [tuple(piece) for piece in pieces]


def _suffix(names: set[str]) -> str:
    return next((suffix for suffix in POINTS if any(name.endswith(suffix) for name in names)), POINTS[0])


def _is_frame(name: str) -> bool:
    return re.fullmatch(r"\d{1,24}\.yaml", name) is not None


def _holds_frame(folder: Path) -> bool:
    return any(_is_frame(file.name) for file in folder.iterdir())


def _folders(folder: Path) -> list[Path]:
    return sorted(inner for inner in folder.iterdir() if inner.is_dir())


def _agents(folder: Path) -> list[str]:
    return sorted(
        inner.name for inner in folder.iterdir() if re.fullmatch(r"-?\d{1,18}", inner.name) and inner.is_dir()
    )


def _hint(root: Path) -> str:
    """Where the user may have wanted to point."""
    if _holds_frame(root):
        return f"; it is one agent's folder: point to {root.resolve().parents[1]}"
    if is_scenario(root):
        place = root.resolve()
        return f"; it is one scenario: point to the folder that holds it, {place.parent}, with scenes={place.name}"
    inner = _folders(root)[:_MOST]
    if splits := [folder.name for folder in inner if any(is_scenario(part) for part in _folders(folder)[:_MOST])]:
        return f"; it has the splits {', '.join(splits)}: choose one with split="
    if _DAIR & {folder.name for folder in inner}:
        return f"; it is laid out as DAIR-V2X-C: open it as dair-v2x:{root}"
    for folder in inner:
        for part in _folders(folder)[:_MOST]:
            if any(is_scenario(last) for last in _folders(part)[:_MOST]):
                return f"; point to {folder} with split={part.name}"
    if any(_agents(folder) for folder in inner):
        return "; numbered folders are there, but they hold no frame (a file like 000069.yaml)"
    return ""
