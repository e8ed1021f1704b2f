"""The time between two files: by numbers, timestamps and speeds; contradictions are errors with the way out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cp_env.scenes.errors import BrokenData
from cp_env.scenes.formats import pcd
from cp_env.scenes.opv2v.files import read_note
from cp_env.scenes.opv2v.folders import survey
from cp_env.scenes.opv2v.frame_rate import by_numbers, by_speeds, by_timestamps, settle
from cp_env.scenes.opv2v.layouts import OPV2V as CARLA
from cp_env.scenes.opv2v.layouts import V2X_REAL
from cp_env.scenes.opv2v.source import OPV2V
from cp_env.scenes.opv2v.v2x_real import V2XReal


def write_drive(
    root: Path, *, step: int = 2, seconds: float = 0.1, unit: float = 3.6, stamp: float | None = None, start: int = 69,
    frames: int = 15, speed: float = 10.0, says: float | None = None,
) -> Path:  # fmt: skip
    """One agent that drives east at `speed` m/s, and says so in m/s times `unit`; a file every `seconds`."""
    folder = root / "drive"
    (folder / "1").mkdir(parents=True)
    for k in range(frames):
        x = speed * seconds * k
        lines = [f"lidar_pose: [{x}, 0, 2, 0, 0, 0]", f"true_ego_pos: [{x}, 0, 0, 0, 0, 0]", "vehicles: {}"]
        lines.append(f"ego_speed: {unit * (speed if says is None else says)}")
        if stamp is not None:
            lines.append(f"timestamp: {1.65e9 + stamp * k:.6f}")
        stem = folder / "1" / f"{start + step * k:06d}"
        stem.with_suffix(".yaml").write_text("\n".join(lines))
        pcd.write(stem.with_suffix(".pcd"), np.array([[5.0, 0, -2], [6, 0, -2]], dtype=np.float32))
    return folder


@pytest.mark.parametrize(
    ("files", "options", "dt"),
    [
        pytest.param({}, {}, 0.2, id="ticks"),
        pytest.param({"speed": 0.0}, {}, 0.2, id="ticks, nothing moves"),
        pytest.param({"says": 0.0}, {}, 0.2, id="ticks, speeds left at 0"),
        pytest.param({"stamp": 0.1}, {}, 0.2, id="ticks and timestamps"),
        pytest.param({"step": 4, "seconds": 0.2}, {}, 0.2, id="every fourth tick"),
        pytest.param({"step": 1, "seconds": 0.1}, {}, 0.2, id="a count at 10 Hz, by speeds"),
        pytest.param({"step": 1, "seconds": 0.05}, {}, 0.2, id="a count at 20 Hz, by speeds"),
        pytest.param({"step": 1, "seconds": 0.1, "unit": 1.0}, {}, 0.2, id="a count at 10 Hz, by speeds in m/s"),
        pytest.param({"step": 1, "seconds": 0.1, "says": 0.0, "stamp": 0.1}, {}, 0.2, id="a count, by timestamps"),
        pytest.param({"step": 1, "seconds": 0.2, "stamp": 0.2}, {}, 0.2, id="a count at 5 Hz, by timestamps"),
        pytest.param({"step": 1, "seconds": 0.1, "speed": 0.0}, {"tick": 0.1}, 0.2, id="a count, and said"),
        pytest.param({"stamp": 0.2}, {"tick": 0.1, "stride": 1}, 0.2, id="a contradiction, and said"),
    ],
)
def test_the_files_say_it(files: dict[str, Any], options: dict[str, Any], dt: float, tmp_path: Path) -> None:
    write_drive(tmp_path, **files)
    assert OPV2V(tmp_path, **options).load("drive").dt == pytest.approx(dt)


@pytest.mark.parametrize(
    ("files", "told"),
    [
        pytest.param({"seconds": 0.2}, r"numbers that it is 0\.05 s .*speeds that it is 0\.1 s \(km/h\)", id="speeds"),
        pytest.param({"stamp": 0.2}, r"numbers that it is 0\.05 s .*timestamps that it is 0\.1 s", id="timestamps"),
        pytest.param({"step": 1, "speed": 0.0}, r"one by one, .*tick=0\.05 or ", id="nothing tells"),
        pytest.param({"step": 1, "seconds": 0.7}, r"0\.05 or 0\.1 s .*speeds that it is 0\.7 s", id="a count, speeds"),
        pytest.param({"step": 1, "stamp": 0.3}, r"timestamps that it is 0\.3 s, ways", id="timestamps and speeds"),
    ],
)
def test_a_contradiction_is_an_error_with_the_way_out(files: dict[str, Any], told: str, tmp_path: Path) -> None:
    write_drive(tmp_path, **files)
    with pytest.raises(BrokenData, match=rf"drive: .*{told}.*tick="):
        OPV2V(tmp_path).load("drive")
    assert OPV2V(tmp_path, tick=0.1, stride=1).load("drive").n_frames == 15


def test_real_recordings_count_at_10_hz_and_may_be_contradicted(tmp_path: Path) -> None:
    write_drive(tmp_path / "good", step=1, start=0, says=0.0)
    assert V2XReal(tmp_path / "good", stride=1).load("drive").dt == pytest.approx(0.1)
    write_drive(tmp_path / "bad", step=1, start=0, seconds=0.2)
    with pytest.raises(BrokenData, match=r"numbers that it is 0\.1 s .*speeds that it is 0\.2 s"):
        V2XReal(tmp_path / "bad").load("drive")


def test_times_of_a_clock_in_names(tmp_path: Path) -> None:
    """Milliseconds: 100 from file to file."""
    write_drive(tmp_path, step=100, start=1_650_000_000_000, speed=0.0)
    assert OPV2V(tmp_path).load("drive").dt == pytest.approx(0.2)


@pytest.mark.parametrize(("scale", "stamp"), [(1.0, 0.1), (1e3, 0.1), (1e6, 0.1), (1e9, 0.1)])
def test_timestamps_in_any_unit(scale: float, stamp: float, tmp_path: Path) -> None:
    folder = write_drive(tmp_path, stamp=stamp, frames=4)
    for file in folder.glob("1/*.yaml"):
        head, _, value = file.read_text().rpartition("timestamp: ")
        file.write_text(f"{head}timestamp: {round(float(value) * scale, 3)}")
    found = survey(folder)
    frames = [(number, [read_note(found.note("1", number))]) for number in found.numbers]
    assert by_timestamps(frames) == pytest.approx(0.05, rel=1e-3), "for one number, of which a file takes two"


def test_ways_against_speeds_by_hand(tmp_path: Path) -> None:
    """10 m/s, 1 m a file, two numbers a file, speed in km/h: 1 / 36 / 2 for one number."""
    found = survey(write_drive(tmp_path))
    frames = [(number, [read_note(found.note("1", number))]) for number in found.numbers]
    assert by_speeds(frames) == pytest.approx(1 / 72) and by_speeds(frames[:5]) is None, "four ways are too few"
    assert by_numbers(found, CARLA) == (0.05,) and by_numbers(found, V2X_REAL) == (0.1,)
    assert settle(found, CARLA, frames) == 0.05
