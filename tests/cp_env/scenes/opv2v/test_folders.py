"""Folders: what is a scenario, where to point instead, and the runs of frames between holes."""

from __future__ import annotations

from pathlib import Path

import pytest

from cp_env.scenes.errors import BrokenData
from cp_env.scenes.opv2v.folders import Scenario, runs, scenarios, survey, usual_step


def touch(root: Path, *files: str) -> Path:
    for file in files:
        (root / file).parent.mkdir(parents=True, exist_ok=True)
        (root / file).touch()
    return root


def frames(agent: str, *numbers: int, suffix: str = ".pcd") -> list[str]:
    return [f"{agent}/{number:06d}{ending}" for number in numbers for ending in (".yaml", suffix)]


def test_a_scenario_by_hand(tmp_path: Path) -> None:
    touch(tmp_path, *frames("7", 69, 71), *frames("12", 67, 69, 71, 73), *frames("-1", 69, 71), *frames("-2", 69))
    touch(tmp_path, "data_protocol.yaml", "7/000069_camera0.png", "7/000069_additional.yaml", "notes/1.txt")
    found = survey(tmp_path)
    assert (found.agents, found.rsu, found.step) == (("12", "7", "-1"), "-1", 2), "names sorted as text"
    assert found.numbers == ("000067", "000069", "000071", "000073")
    assert {number: error.file.relative_to(tmp_path).as_posix() for number, error in found.missing.items()} == {
        "000067": "7/000067.yaml",
        "000073": "7/000073.yaml",
    }
    assert found.points("7", "000069") == tmp_path / "7/000069.pcd"


def test_frames_are_the_egos_and_those_between(tmp_path: Path) -> None:
    touch(tmp_path, *frames("1", 0, 2, suffix=".bin"), *frames("2", 0, 1, 2, 3))
    found = survey(tmp_path)
    assert found.numbers == ("000000", "000001", "000002") and set(found.missing) == {"000001"}
    assert found.points("1", "000002").suffix == ".bin" and found.points("2", "000002").suffix == ".pcd"


def scenario(*numbers: int, step: int | None = None) -> Scenario:
    names = tuple(f"{number:06d}" for number in numbers)
    return Scenario(Path("drive"), ("1",), None, names, step or usual_step(names), {"1": ".pcd"})


@pytest.mark.parametrize(
    ("numbers", "stride", "lost", "pieces"),
    [
        ((69, 71, 73, 75, 77), 1, (), [(69, 71, 73, 75, 77)]),
        ((69, 71, 73, 75, 77), 2, (), [(69, 73, 77)]),
        ((69, 71, 73, 75, 77), 2, (71, 75), [(69, 73, 77)]),
        ((69, 71, 73, 75, 77), 2, (73,), [(69,), (77,)]),
        ((69, 71, 73, 75, 77), 1, (69, 77), [(71, 73, 75)]),
        ((69, 71, 75, 77, 79), 2, (), [(69,), (77,)]),
        ((69, 71, 73, 74, 76, 78), 1, (), [(69, 71, 73), (74, 76, 78)]),
        ((0, 1, 2, 3, 4, 5, 6), 3, (), [(0, 3, 6)]),
        ((5,), 2, (), [(5,)]),
        ((5,), 2, (5,), []),
    ],
)
def test_runs_by_hand(
    numbers: tuple[int, ...], stride: int, lost: tuple[int, ...], pieces: list[tuple[int, ...]]
) -> None:
    """69, 71, 75, 77, 79 by twos: 73 is not there, so nothing follows 69 and 77 begins anew."""
    found = runs(scenario(*numbers), stride, [f"{number:06d}" for number in lost])
    assert [tuple(map(int, piece)) for piece in found] == pieces


def test_times_of_a_clock_jitter() -> None:
    clock = [1_650_000_000_000, 1_650_000_000_101, 1_650_000_000_199, 1_650_000_000_300, 1_650_000_000_502]
    drive = scenario(*clock)
    assert drive.by_clock and drive.step == 101
    assert [len(piece) for piece in runs(drive, 1)] == [4, 1]


def test_where_to_point(tmp_path: Path) -> None:
    drive = "OPV2V/test/2021"
    touch(tmp_path, *(f"{drive}/{file}" for file in frames("7", 69)))
    assert list(scenarios(tmp_path / "OPV2V/test")) == ["2021"]
    for path, told in (
        (drive, rf"is one scenario: point to the folder that holds it, {tmp_path}/OPV2V/test, with scenes=2021"),
        (f"{drive}/7", rf"is one agent's folder: point to {tmp_path}/OPV2V/test"),
        ("OPV2V", "has the splits test: choose one with split="),
        (".", rf"point to {tmp_path}/OPV2V with split=test"),
        ("nowhere", "is no folder"),
    ):
        with pytest.raises(BrokenData, match=told):
            scenarios(tmp_path / path)


def test_a_dair_like_folder_is_not_taken_for_opv2v(tmp_path: Path) -> None:
    """It has numbered files in folders, and may have numbered folders of batches, but no agents' frames."""
    root = touch(
        tmp_path / "DAIR-V2X-C",
        "cooperative/data_info.json",
        "vehicle-side/velodyne/000010.pcd",
        "vehicle-side/0/000010.json",
        "infrastructure-side/label/000010.json",
    )
    with pytest.raises(BrokenData, match=rf"is laid out as DAIR-V2X-C: open it as dair-v2x:{root}"):
        scenarios(root)
    plain = touch(tmp_path / "other", "batch/0/000010.pcd")
    with pytest.raises(BrokenData, match="they hold no frame"):
        scenarios(plain)
