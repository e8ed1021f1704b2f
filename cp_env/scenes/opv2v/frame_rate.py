"""The time that one file number stands for, as the files say: by their numbers, timestamps, and speeds.

Numbers that count CARLA's ticks, times of a clock in names or in the key `timestamp`, and the way that vehicles make
against the speed they are said to have are three witnesses. Where two contradict each other, the error says how to
decide with the option `tick`.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from cp_env.scenes.errors import BrokenData
from cp_env.scenes.opv2v.axes import planar
from cp_env.scenes.opv2v.files import Note
from cp_env.scenes.opv2v.folders import Scenario
from cp_env.scenes.opv2v.layouts import Layout

AGREE = 1.25  # two times agree within this factor; a speed is a moment's, a way is a frame's
LEAST = 5  # measured ways that speeds are judged by
SLOW = 5.0  # in the file's unit: what moves slower is not measured
STEADY = 0.3  # share by which a speed may change from frame to frame and still be measured
KMH = 3.6
_CLOCKS = ((11, 1.0), (14, 1e-3), (17, 1e-6), (99, 1e-9))  # digits of a clock's time, below which it counts these s

Frames = Sequence[tuple[str, Sequence[Note]]]  # a number, and what each agent says of it


def by_numbers(scenario: Scenario, layout: Layout) -> tuple[float, ...]:
    """Seconds that one file number may stand for: one, or several where numbers are but a count."""
    if scenario.by_clock:
        return (_unit(len(scenario.numbers[0].lstrip("0"))),)
    return layout.counts if scenario.step == 1 else (layout.tick,)


def settle(scenario: Scenario, layout: Layout, frames: Frames) -> float:
    """Seconds that one file number stands for, from some frames where numbers alone leave it open.

    Raises:
        BrokenData: nothing decides, or two witnesses contradict each other.
    """
    times = by_numbers(scenario, layout)
    stamps, ways = by_timestamps(frames), by_speeds(frames)
    if stamps is not None:
        return stamps if ways is None or _fits(stamps, ways) else _contradiction(scenario, times, stamps, ways)
    chosen = times if ways is None else [time for time in times if _fits(time, ways)]
    if not chosen:
        return _contradiction(scenario, times, stamps, ways)
    if len(chosen) > 1:
        either = " or ".join(f"tick={time:g}" for time in times)
        raise BrokenData(
            scenario.folder,
            f"numbers its files one by one, which says nothing of the time between them, and neither timestamps nor "
            f"speeds do; say it with {either} (seconds from one number to the next)",
        )
    return chosen[0]


def check(scenario: Scenario, tick: float, frames: Frames) -> None:
    """Nothing if what the frames say agrees with `tick` seconds for one file number.

    Raises:
        BrokenData: timestamps, or ways against speeds, say otherwise.
    """
    stamps, ways = by_timestamps(frames), by_speeds(frames)
    if (stamps is not None and not _close(stamps, tick)) or (ways is not None and not _fits(tick, ways)):
        _contradiction(scenario, (tick,), stamps, ways)


def by_timestamps(frames: Frames) -> float | None:
    """Seconds that one file number stands for by the key `timestamp`; None if it is not given everywhere."""
    stamps = [notes[0].timestamp for _, notes in frames]
    given = [stamp for stamp in stamps if stamp is not None]
    if len(given) < max(2, len(stamps)):
        return None
    steps = [
        (b - a) / (int(n) - int(m)) for (a, m), (b, n) in pairwise(zip(given, [n for n, _ in frames], strict=True))
    ]
    step = float(np.median(steps)) * _unit(len(str(int(abs(given[0])))))
    return round(step, 4) if step > 1e-4 else None


def by_speeds(frames: Frames) -> float | None:
    """Way against speed for one file number, in the unit of way over the unit of speed; None if too little moves.

    In seconds if speeds are in m/s; times `KMH` if they are in km/h.
    """
    found: list[float] = []
    for (m, before), (n, after) in pairwise(frames):
        for one, two in zip(before, after, strict=True):
            place = {number: row for row, number in enumerate(two.numbers)}
            pairs = [(row, place[number]) for row, number in enumerate(one.numbers) if number in place]
            a, b = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
            own = [planar(note.lidar if note.body is None else note.body)[:2] for note in (one, two)]
            way = np.linalg.norm(
                np.vstack([two.pose[b, :2, 3], own[1]]) - np.vstack([one.pose[a, :2, 3], own[0]]), axis=1
            )
            speed = np.array([np.append(one.speeds[a], one.speed), np.append(two.speeds[b], two.speed)])
            mean, change = speed.mean(axis=0), np.abs(speed[1] - speed[0])
            good = (speed.min(axis=0) > SLOW) & (change <= STEADY * mean)  # a NaN compares false
            found += (way[good] / mean[good] / (int(n) - int(m))).tolist()
    return float(np.median(found)) if len(found) >= LEAST and np.median(found) > 0 else None


def _unit(digits: int) -> float:
    return next(unit for most, unit in _CLOCKS if digits < most)


def _close(one: float, other: float) -> bool:
    return max(one, other) <= AGREE * min(one, other)


def _fits(time: float, ways: float) -> bool:
    """Whether ways against speeds say this time, in km/h or in m/s."""
    return _close(time, KMH * ways) or _close(time, ways)


def _contradiction(scenario: Scenario, times: Sequence[float], stamps: float | None, ways: float | None) -> float:
    said = [f"numbers that it is {' or '.join(f'{time:g}' for time in times)} s from one to the next"]
    said += [f"timestamps that it is {stamps:g} s"] if stamps is not None else []
    said += [f"ways against speeds that it is {KMH * ways:.3g} s (km/h) or {ways:.3g} s (m/s)"] if ways else []
    raise BrokenData(
        scenario.folder,
        f"contradicts itself on its frame rate: {', '.join(said)}; say which with tick= (seconds from one file number "
        "to the next)",
    )
