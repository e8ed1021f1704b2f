"""The table of the closed loop, of drives made by hand; driving itself is tested with `live_drive`."""

from __future__ import annotations

import io
import math

import pytest
from rich.console import Console

from cp_env.driving import Drive
from cp_env.evaluation.execution.live_drive import LiveDrive
from examples.reproduce.live_driving import open_live, table


def drive(*, collided: bool, nearest: float = math.inf) -> LiveDrive:
    one = Drive(
        collided=collided,
        hard_brakings=int(collided),
        min_time_to_collision=nearest,
        mean_speed=4.0,
        hardest_braking=9.0,
        impact_speed=3.0 * collided,
    )
    return LiveDrive(drive=one, struck=1, crossed=0, frames=60, damage=0.1)


def test_rates_and_means_of_each_row() -> None:
    """One of three collides and brakes hard; two come near something, in 1 and 3 s."""
    drives = [drive(collided=True, nearest=1.0), drive(collided=False, nearest=3.0), drive(collided=False)]
    console = Console(width=400, record=True, file=io.StringIO())
    console.print(table({"prbi": drives}))
    told = console.export_text()
    assert "3 drives each" in told
    assert told.count("1 of 3 [0.01, 0.91]") == 2
    assert "2.0 [0.0, 14.7]" in told and "4.00 [4.00, 4.00]" in told and "0.100" in told


def test_recorded_scenes_do_not_react() -> None:
    with pytest.raises(ValueError, match="choose scenes such as sumo:urban, not town/test"):
        open_live("town/test")
