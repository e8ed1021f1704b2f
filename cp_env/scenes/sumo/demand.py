"""When the demand of a configuration drives: departures counted by the minute, and the busiest hour among them.

Convention: times are seconds of the simulation's clock, as in SUMO's files.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from cp_env.scenes.errors import BrokenData
from cp_env.scenes.sumo.network import NO_CARS
from cp_env.scenes.sumo.xml_files import children

MINUTE, HOUR, DAY = 60.0, 3600.0, 86400.0  # s
LONGEST = 366 * DAY  # s: later departures are refused
MOST_TYPES = 100_000  # vehicle types that are no cars, remembered while counting

_NO_CAR_TYPES = ("DEFAULT_PEDTYPE", "DEFAULT_BIKETYPE", "DEFAULT_CONTAINERTYPE", "DEFAULT_RAILTYPE")


@dataclass(frozen=True)
class Period:
    """A part of the demand: its first second, how long vehicles depart from then on, and how many do."""

    begin: float
    span: float
    departures: float


def seconds(text: str) -> float:
    """A time as SUMO writes it: seconds, `h:m:s` or `d:h:m:s`.

    Raises:
        ValueError: it is none of them.
    """
    try:
        parts = [float(part) for part in text.split(":")]
    except ValueError:
        parts = []
    if len(parts) not in (1, 3, 4) or not np.isfinite(parts).all():
        raise ValueError(f"{text!r} is no time: write seconds, h:m:s or d:h:m:s")
    scales = (1.0, 60.0, HOUR, DAY)
    sign = -1.0 if text.strip().startswith("-") else 1.0
    return sign * sum(scale * abs(part) for scale, part in zip(scales, reversed(parts), strict=False))


def departures(files: Iterable[Path], until: float) -> Float[np.ndarray, " M"]:
    """Departures of cars in each minute from 0 s on, read element by element.

    `vehicle` and `trip` count once, `flow` as often as it sends a vehicle. Left out are vehicle types whose class is no
    car (see `NO_CARS`), people, and vehicles that wait for somebody ("triggered").

    Args:
        files: route and additional files; vehicle types before the vehicles that have them.
        until: s, the end of a flow that names none.

    Returns:
        Departures by the minute; no minute after the last departure.

    Raises:
        BrokenData: a file is missing or no XML, a time or a rate is no number, or a vehicle departs after 366 days.
    """
    counts = np.zeros(int(LONGEST / MINUTE))
    no_cars = set(_NO_CAR_TYPES)
    for file in files:
        for element in children(file):
            for kind in element.iter("vType"):
                if kind.get("vClass") in NO_CARS and len(no_cars) < MOST_TYPES:
                    no_cars.add(kind.get("id", ""))
            if element.tag in ("vehicle", "trip", "flow") and element.get("type") not in no_cars:
                try:
                    _add(counts, element, until)
                except (ValueError, ZeroDivisionError, OverflowError) as error:
                    raise BrokenData(file, f"{element.tag} {element.get('id')!r}: {error}") from error
    return np.trim_zeros(counts, "b")


def _add(counts: Float[np.ndarray, " M"], element: ET.Element, until: float) -> None:
    if element.tag != "flow":
        if element.get("depart", "").strip()[:1].isalpha():  # "triggered" and the like
            return
        counts[_minute(seconds(element.get("depart", "0")))] += 1
        return
    begin = seconds(element.get("begin", "0"))
    if not 0 <= begin < LONGEST:
        raise ValueError(f"it begins at {begin:.0f} s, which is not within 0 and 366 days")
    end = seconds(element.get("end", "-1"))
    end = min(end if end >= 0 else max(until, begin), LONGEST - 1)
    number = float(element.get("number", "inf"))
    rate = _rate(element)
    if rate is None:
        rate = number / max(end - begin, 1.0)
    if not (np.isfinite(rate) and rate >= 0):
        raise ValueError(f"it sends {rate} vehicles a second; give it a number, a period or vehsPerHour")
    if rate * (end - begin) > number:
        end = begin + number / rate
    edges = np.clip(np.arange(int(begin // MINUTE), int(end // MINUTE) + 2) * MINUTE, begin, end)
    counts[int(begin // MINUTE) : int(end // MINUTE) + 1] += rate * np.diff(edges)


def _minute(time: float) -> int:
    if not 0 <= time < LONGEST:
        raise ValueError(f"it departs at {time:.0f} s, which is not within 0 and 366 days")
    return int(time // MINUTE)


def _rate(flow: ET.Element) -> float | None:
    """Vehicles a second, where the flow says it."""
    for key in ("period", "vehsPerHour", "perHour", "probability"):
        said = flow.get(key)
        if said is None:
            continue
        if said.startswith("exp("):
            return float(said[4:].rstrip(") "))
        value = float(said)
        return {"period": 1 / value if value else np.inf, "probability": value}.get(key, value / HOUR)
    return None


def busiest(per_minute: Float[np.ndarray, " M"], first: float, last: float) -> Period | None:
    """The hour with the most departures between `first` and `last` s, the earliest of several; None if nothing departs.

    It begins and ends with a minute in which something departs. Where nothing departs between `first` and `last`, the
    whole demand is searched.

    Args:
        per_minute: departures in each minute from 0 s on.
        first: s, where a configuration begins.
        last: s, where it ends; may be infinite.

    Returns:
        At most an hour of the demand.
    """
    low = int(first // MINUTE)
    high = len(per_minute) if last >= MINUTE * len(per_minute) else int(np.ceil(last / MINUTE))
    part = per_minute[low:high]
    if not part.any():
        low, part = 0, per_minute
    if not part.any():
        return None
    total = np.concatenate([[0.0], np.cumsum(part)])
    starts = np.arange(max(1, len(part) - 59))
    sums = total[np.minimum(starts + 60, len(part))] - total[starts]
    start = int(np.flatnonzero(sums >= sums.max() * (1 - 1e-9))[0])
    found = within(per_minute, MINUTE * (low + start))
    leading = MINUTE * float(np.flatnonzero(per_minute[low + start :])[0])
    begin = max(found.begin + leading, first if first < found.begin + leading + MINUTE else 0.0)
    return Period(begin, found.begin + found.span - begin, found.departures)


def within(per_minute: Float[np.ndarray, " M"], begin: float) -> Period:
    """The hour that begins at `begin` s, to the last minute of it in which something departs."""
    low = int(begin // MINUTE)
    part = np.trim_zeros(per_minute[low : low + 60], "b")
    return Period(begin, max(0.0, MINUTE * (low + len(part)) - begin), float(part.sum()))
