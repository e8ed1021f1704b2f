"""What holds for every family in OPV2V's folders."""

from __future__ import annotations

import contextlib
import pickle
import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cp_env.scenes import open_source
from cp_env.scenes.errors import BrokenData
from cp_env.scenes.opv2v.files import read_note
from cp_env.scenes.opv2v.recorded import Options, Recorded
from cp_env.scenes.opv2v.writer import LAYOUTS, write
from cp_env.scenes.preview.classes import NamesClasses
from cp_env.testing import check_scenes
from tests.helpers.toy_scenes import ToySource

KINDS = sorted(LAYOUTS)


@pytest.fixture(params=KINDS)
def made(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[str, Path]:
    town = ToySource(n_frames=6, n_connected=2, rsu=False)
    write(town, town.names(), tmp_path / "test", kind=request.param)
    return request.param, tmp_path


def opened(made: tuple[str, Path], **options: Any) -> Recorded:
    said = "&".join(f"{key}={value}" for key, value in {"split": "test", **options}.items())
    source = open_source(f"{made[0]}:{made[1]}?{said}")
    assert isinstance(source, Recorded)
    return source


def test_every_family_keeps_the_laws_and_gives_the_same_scenes(made: tuple[str, Path]) -> None:
    source, town = opened(made), ToySource(n_frames=6, n_connected=2, rsu=False)
    check_scenes(source)
    assert source.name == f"{made[0]}/test" and source.names() == town.names()
    for name in town.names():
        scene, back = town.load(name), source.load(name)
        assert back.dt == pytest.approx(scene.dt)
        assert np.abs(back.pose[..., :2] - scene.pose[..., :2]).max() < 1e-3 and np.allclose(back.size, scene.size)
        assert isinstance(source, NamesClasses) == (made[0] != "opv2v"), "OPV2V's files give no classes"
        if isinstance(source, NamesClasses):
            assert len(source.classes(back)) == len(back.size) and set(source.classes(back)) <= {"Car", "vehicle"}


def test_the_digest_changes_with_options_and_files(made: tuple[str, Path]) -> None:
    plain = opened(made)
    options: list[dict[str, Any]] = [{"stride": 2}, {"tick": 0.07}, {"classes": "vehicle,pedestrian"}, {"seed": 3}]
    digests = {opened(made, **some).digest for some in [{}, {}, {"noise": "0.2,0.2"}, *options]}
    assert len(digests) == 6 and plain.digest in digests
    file = next((made[1] / "test").glob("*/*/000000.yaml"))
    file.write_text(file.read_text() + "\n")
    assert opened(made).digest not in digests


def test_everything_read_first_is_the_same(made: tuple[str, Path]) -> None:
    plain, first = opened(made), opened(made, skip_broken=True)
    assert first.names() == plain.names() and first.left_out == () and first.digest == plain.digest
    again = pickle.loads(pickle.dumps(first))
    scene = again.load("toy-1")
    one, other = again.sweeps(scene, [4])[0], plain.sweeps(scene, [4])[0]
    assert all((a.points == b.points).all() for a, b in zip(one, other, strict=True))


def test_a_missing_file_costs_its_frame_in_every_family(made: tuple[str, Path]) -> None:
    agent = sorted((made[1] / "test" / "toy-0").iterdir())[1]
    lost = sorted(file for file in agent.iterdir() if file.suffix != ".yaml")[2]
    lost.unlink()
    with pytest.raises(ValueError, match=rf"{lost.name}: is missing"):
        opened(made)
    source = opened(made, skip_broken=True)
    assert [source.load(name).n_frames for name in source.names()] == [2, 3, 6]
    assert [item.file for item in source.left_out] == [lost]


PIECES = [
    *"[]{}:-?&*!|>'#~\"\n\t\0",
    "é",
    "1e999",
    ".nan",
    "true",
    "<<:",
    "!!int",
    "!!binary",
    "&id001",
    "*id001",
    "9" * 20,
]


def test_a_note_is_read_or_named_whatever_is_done_to_it(made: tuple[str, Path]) -> None:
    rng = random.Random(made[0])
    file = next((made[1] / "test").glob("*/*/000000.yaml"))
    text, layout = file.read_text(), LAYOUTS[made[0]]
    for _ in range(200):
        broken = text
        for _ in range(rng.randint(1, 3)):
            at, to = (
                sorted(rng.choices(range(len(broken)), k=2)) if rng.random() < 0.2 else [rng.randrange(len(broken))] * 2
            )
            broken = broken[:at] + rng.choice(PIECES) + broken[to:]
        file.write_text(broken)
        with contextlib.suppress(BrokenData):
            read_note(file, layout, radians=rng.random() < 0.5)


def test_options_out_of_range_are_refused() -> None:
    for options, told in (
        ({"noise": (float("nan"), 0.0)}, "noise must be two deviations"),
        ({"noise": (float("inf"), 0.0)}, "noise must be two deviations"),
        ({"tick": float("nan")}, "tick above 0"),
        ({"tick": float("inf")}, "tick above 0"),
        ({"stride": 0}, "stride must be at least 1"),
        ({"poses": "wrong"}, "poses must be one of"),
        ({"angles": "grad"}, "angles must be one of"),
    ):
        with pytest.raises(ValueError, match=told):
            Options(**options)  # type: ignore[arg-type]
