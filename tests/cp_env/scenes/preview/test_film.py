"""A preview draws what is there, where it is, and counts who is seen; paths are taken for what they are."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from cp_env.cli import main
from cp_env.scenes.export import export
from cp_env.scenes.opv2v.writer import write
from cp_env.scenes.preview import film
from cp_env.types import Scene, Sweep
from tests.helpers.toy_scenes import ToySource
from tests.helpers.v2xsim_sets import edit

SCENE = Scene(
    name="three",
    kind="recorded",
    dt=0.2,
    pose=np.array([[[0, 0, 0], [20, 10, 0], [-20, -10, np.pi / 2]], [[0, 0, 0], [20, 10, 0], [np.nan] * 3]]),
    size=np.tile([4.0, 2.0, 1.5], (3, 1)),
    connected=np.array([0, 1]),
    rsu=None,
    obstacles=np.array([[0.0, 30.0, 0.0, 10.0, 4.0, 5.0]]),
)


def sweep(x: float, y: float, points: list[list[float]]) -> Sweep:
    return Sweep(np.array(points, dtype=np.float32), np.array([x, y, 1.8]))


class Three:
    """The ego sees row 1 in the first frame only; agent 1 sees row 2 while it is there."""

    name, digest = "three", "three"

    def names(self) -> tuple[str, ...]:
        return ("three",)

    def load(self, name: str) -> Scene:
        return SCENE

    def sweeps(self, scene: Scene, frames: list[int]) -> list[list[Sweep]]:
        met = [[20 + dx, 10, 1.0] for dx in (-1.9, -1.8, -1.7)]
        far = [[-40 + dx, -20, 1.0] for dx in (0.0, 0.1, 0.2)]
        return [
            [sweep(0, 0, met if t == 0 else [[5, 5, 0.0]]), sweep(20, 10, far if t == 0 else [[6, 6, 0.0]])]
            for t in frames
        ]


def at(image: np.ndarray, x: float, y: float, extent: float) -> tuple[int, int, int]:
    """The colour drawn x m east and y m north of the ego."""
    scale = film.SIDE / (2 * extent)
    r, g, b = image[film.TOP + int((extent - y) * scale), film.LEFT + int((x + extent) * scale)].tolist()
    return r, g, b


def test_the_picture_shows_east_on_the_right_and_north_on_top() -> None:
    sweeps = Three().sweeps(SCENE, [0])[0]
    image = film.draw(
        SCENE, 0, [replace(sweeps[0], points=np.float32([[12, 7, 1], [-9, 33, 0]])), sweeps[1]], extent=50
    )
    assert at(image, 12, 7, 50) == film.AGENTS[0], "a return, bright"
    assert at(image, -9, 33, 50) not in (film.AGENTS[0], film.GROUND, film.GRID), "one from the road, dim"
    assert at(image, 18.5, 11.0 - 0.05, 50) == film.AGENTS[1], "the northern edge of agent 1"
    assert at(image, -20 - 1.0 + 0.05, -10.5, 50) == film.MET, "a box along y"
    assert at(image, -20, -9, 50) == film.MET, "its line points to its front, to the north"
    assert at(image, 5.0, 31, 50) == film.WALL
    assert at(image, 12, -7, 50) == film.GROUND
    assert at(image, -20.5, -10.5, 50) == film.GROUND, "what is seen is not filled"
    unseen = film.draw(SCENE, 0, [sweeps[0]] * 2, extent=50)
    assert at(unseen, -20, -9, 50) == film.UNMET
    filled = at(unseen, -20.5, -10.5, 50)
    assert film.GROUND < filled < film.UNMET, "what no sensor sees is"


def test_a_gif_keeps_the_colours() -> None:
    part = film.excerpt(Three(), "three", [0])
    drawn = film.draw(SCENE, 0, part.sweeps[0])
    (kept,) = film.film(part)
    told = np.asarray(kept.convert("RGB"))
    for colour in (film.GROUND, film.MET, film.UNMET, film.MISSED, film.WALL, *film.AGENTS[:2]):
        where = (drawn == colour).all(axis=-1)
        assert where.any() and (told[where] == colour).all(), colour


def test_a_box_that_returns_miss_has_a_colour_of_its_own() -> None:
    """Ten returns 0.5 m north of row 1's box and three in it; seen, but not where it stands."""
    sweeps = Three().sweeps(SCENE, [0])[0]
    outside = [[20 + dx / 10, 11.5, 1.0] for dx in range(10)]
    image = film.draw(
        SCENE, 0, [replace(sweeps[0], points=np.float32([*sweeps[0].points, *outside])), sweeps[1]], extent=50
    )
    assert at(image, 18.5, 11.0 - 0.05, 50) == film.MISSED
    assert at(image, 21.0, 10.5, 50) == film.MISSED, "crossed out: shapes differ as well as colours"
    assert at(image, -20 - 1.0 + 0.05, -10.5, 50) == film.MET


def test_the_command_tells_classes_rate_speeds_redundancy_and_misses(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    arguments = ["--out", str(tmp_path / "film.gif"), "--every", "1"]
    files = export(ToySource(n_frames=3, n_connected=2), tmp_path / "set", names=["toy-1"])
    main(["scenes", "preview", str(files), *arguments])
    told = " ".join(capsys.readouterr().out.split())
    for part in (
        "classes 13 vehicle.car, 1 vehicle.truck",
        "5 frames a second",
        "speeds median 3.0 m/s, 95 % below 5.0, fastest 5.0; 43% stand; the ego's median 5.0",
        "redundancy share of the vehicles in a frame that sensors see: ",
        "returns most lie in their box for",
    ):
        assert part in told, part
    assert "boxes that returns miss" not in told
    edit(files, "sample_annotation", _turn_boxes)
    main(["scenes", "preview", f"v2x-sim:{files}", *arguments, "--vehicles", "3"])
    told = " ".join(capsys.readouterr().out.split())
    assert "boxes that returns miss (3 of" in told and "row class frame agent returns in the box" in told


def _turn_boxes(records: list[dict[str, Any]]) -> None:
    """A quarter turn to the left, each."""
    for record in records:
        w, _, _, z = record["rotation"]
        record["rotation"] = [(w - z) / 2**0.5, 0.0, 0.0, (w + z) / 2**0.5]


def test_the_command_films_a_folder_and_prints_its_figures(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    source = ToySource(n_frames=3, n_connected=2)
    write(source, ["toy-0"], tmp_path / "data")
    gif_path = tmp_path / "film.gif"
    main(["scenes", "preview", str(tmp_path / "data"), "--out", str(gif_path), "--every", "1"])
    told = " ".join(capsys.readouterr().out.split())
    for part in (
        "2 connected vehicles and a road-side unit 6.0 m up",
        "14 in all",
        "0.6 s at 5 frames a second",
        "14 in a frame classes",
        "0 ego",
    ):
        assert part in told
    with Image.open(gif_path) as gif:
        assert gif.format == "GIF" and gif.n_frames == 3 and gif.size == film.SIZE
    with pytest.raises(SystemExit, match="every must be at least 1"):
        main(["scenes", "preview", str(tmp_path / "data"), "--every", "0"])


def test_a_path_is_taken_for_what_lies_there(tmp_path: Path) -> None:
    assert film.spec_of("town/test") == "town/test"
    assert film.spec_of("opv2v:/nowhere?split=test") == "opv2v:/nowhere?split=test"
    for kind, file in (
        ("sumo", "a.net.xml"),
        ("sumo", "b.sumocfg"),
        ("sumo", "c.net.xml.gz"),
        ("v2x-sim", "V2X-Sim-2.0/v2.0/scene.json"),
        ("v2x-sim-det", "det/test/agent1/5_0/0.npy"),
        ("opv2v", "OPV2V/test/2021/7/000069.pcd"),
        ("dair-v2x", "DAIR-V2X-C/cooperative-vehicle-infrastructure/cooperative/data_info.json"),
        ("dair-v2x", "inner/cooperative/data_info.json"),
        ("nuscenes", "nuscenes/samples/LIDAR_TOP/a.pcd.bin"),
    ):
        path = tmp_path / file
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
        root = path if kind == "sumo" else tmp_path / file.split("/")[0]
        if kind == "nuscenes":
            (root / "v1.0-mini").mkdir()
            (root / "v1.0-mini/scene.json").touch()
        assert film.spec_of(str(root)) == f"{kind}:{root}"
    (tmp_path / "pictures").mkdir()
    with pytest.raises(ValueError, match="is no data set that is known here"):
        film.spec_of(str(tmp_path / "pictures"))
