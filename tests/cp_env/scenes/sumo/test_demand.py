"""Departures by the minute and the busiest hour, worked by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cp_env.scenes.errors import BrokenData
from cp_env.scenes.sumo.demand import DAY, Period, busiest, departures, seconds, within


@pytest.mark.parametrize(
    ("text", "expected"), [("0", 0), ("28800.5", 28800.5), ("8:0:0", 28800), ("1:8:0:30", 115230), ("-1", -1)]
)
def test_times_as_sumo_writes_them(text: str, expected: float) -> None:
    assert seconds(text) == expected


@pytest.mark.parametrize("text", ["", "noon", "8:00", "nan", "1:2:3:4:5"])
def test_what_is_no_time_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="is no time: write seconds, h:m:s or d:h:m:s"):
        seconds(text)


def counted(tmp_path: Path, *texts: str, until: float = DAY) -> list[float]:
    files = []
    for k, text in enumerate(texts):
        files.append(tmp_path / f"{k}.rou.xml")
        files[-1].write_text(f"<routes>{text}</routes>")
    return np.round(departures(files, until), 6).tolist()


def test_vehicles_and_trips_count_once(tmp_path: Path) -> None:
    text = '<vehicle id="a" depart="0"/><trip id="b" depart="59.9"/><trip id="c" depart="0:2:0"/>'
    assert counted(tmp_path, text) == [2, 0, 1]


@pytest.mark.parametrize(
    ("flow", "expected"),
    [
        ('begin="0" end="120" period="10"', [6, 6]),
        ('begin="30" end="90" vehsPerHour="720"', [6, 6]),
        ('begin="0" end="120" perHour="360"', [6, 6]),
        ('begin="60" end="120" probability="0.5"', [0, 30]),
        ('begin="0" end="180" number="9"', [3, 3, 3]),
        ('begin="0" end="180" number="6" period="10"', [6]),
        ('begin="0" end="120" period="exp(0.1)"', [6, 6]),
        ('begin="0" period="30"', [2, 2, 2]),  # to the end of the configuration's period
        ('begin="0" end="120" period="10" type="bike"', []),
        ('begin="0" end="120" period="10" type="DEFAULT_BIKETYPE"', []),
    ],
)
def test_a_flow_counts_as_often_as_it_sends(tmp_path: Path, flow: str, expected: list[float]) -> None:
    types = '<vType id="bike" vClass="bicycle"/>'
    assert counted(tmp_path, types, f'<flow id="f" {flow}/>', until=180) == expected


def test_only_cars_are_counted(tmp_path: Path) -> None:
    types = (
        '<vTypeDistribution id="all"><vType id="t" vClass="tram"/><vType id="b" vClass="bus"/></vTypeDistribution>'
        '<vType id="s" vClass="ship"/><vType id="car"/>'
    )
    kinds = "t", "b", "s", "car", "all"
    vehicles = "".join(f'<vehicle id="{k}" type="{k}" depart="5"/>' for k in kinds)
    people = '<person id="p" depart="5"/><vehicle id="w" depart="triggered"/>'
    assert counted(tmp_path, types + vehicles + people) == [3], "the bus, the car, and one of the distribution"


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ('<trip id="t" depart="1e9"/>', r"trip 't': it departs at 1000000000 s, which is not within 0 and 366 days"),
        ('<trip id="t" depart="-5"/>', "trip 't'"),
        ('<trip id="t" depart="1:2"/>', "trip 't': '1:2' is no time"),
        ('<flow id="f" begin="0" end="9"/>', "flow 'f': it sends inf vehicles a second; give it a number"),
        ('<flow id="f" begin="0" end="9" period="x"/>', "flow 'f'"),
        ('<flow id="f" begin="0" end="9" probability="-1"/>', "flow 'f': it sends -1"),
    ],
)
def test_what_cannot_be_is_told(tmp_path: Path, text: str, told: str) -> None:
    with pytest.raises(BrokenData, match=told):
        counted(tmp_path, text)


def test_the_busiest_hour_of_a_day() -> None:
    """Nothing before 28,800 s, one a minute to noon, three a minute from 17 to 18 o'clock."""
    day = np.zeros(1440)
    day[480:720] = 1
    day[1020:1080] = 3
    assert busiest(day, 0, np.inf) == Period(61200, 3600, 180)
    assert busiest(day, 0, 61200) == Period(28800, 3600, 60), "the earliest of several, within the period"
    assert busiest(day, 28810, np.inf) == Period(61200, 3600, 180)
    assert busiest(day, 28810, 30000) == Period(28810, 3590, 60), "it begins where the configuration does"
    assert busiest(day, 0, 3600) == Period(61200, 3600, 180), "a period without departures is none"
    assert busiest(np.zeros(0), 0, np.inf) is None


def test_a_short_demand_is_its_own_busiest_hour() -> None:
    few = np.array([0, 0, 2, 0, 1.0])
    assert busiest(few, 0, np.inf) == Period(120, 180, 3)
    assert within(few, 60) == Period(60, 240, 3)
    assert within(few, 600) == Period(600, 0, 0)


def test_busiest_agrees_with_trying_every_hour() -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        day = rng.poisson(0.3, rng.integers(1, 300)).astype(float)
        found = busiest(day, 0, np.inf)
        sums = [day[k : k + 60].sum() for k in range(len(day))]
        assert found is None if not day.any() else found is not None and found.departures == max(sums)
