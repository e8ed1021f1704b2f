"""The command line does what it says, and answers bad input with one line."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest
from PIL import Image

import cp_env
from cp_env.cli import SUMMARY, main
from cp_env.detector import load_detector
from cp_env.scenes.export import export
from cp_env.world.scene_cache import SceneBank
from tests.helpers.toy_scenes import ToySource


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    main(["version"])
    assert capsys.readouterr().out == f"{cp_env.__version__}\n"


def test_help_lists_commands_as_they_are_typed(capsys: pytest.CaptureFixture[str]) -> None:
    """Every line of the help is a command that takes --help."""
    main(["--version"])
    assert capsys.readouterr().out == f"{cp_env.__version__}\n"
    main(["--help"])
    listed = [
        line.split("  ")[2].removeprefix("cp-env ")
        for line in capsys.readouterr().out.splitlines()[4:]
        if "    cp-env" in line
    ]
    assert listed == list(SUMMARY) and "scenes preview" in listed
    for command in listed:
        with pytest.raises(SystemExit, match="0"):
            main([*command.split(), "--help"])
        assert f"usage: cp-env {command}" in " ".join(capsys.readouterr().out.split())
    main([])
    assert "usage: cp-env COMMAND" in capsys.readouterr().out
    with pytest.raises(SystemExit, match=r"unknown command 'scens' .did you mean 'scenes'"):
        main(["scens"])


def test_classes_in_the_current_folder_are_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """As `python` itself does: a console script begins elsewhere."""
    (tmp_path / "mine_in_a_folder.py").write_text(
        "from tests.helpers.toy_scenes import ToySource\n\nclass Mine(ToySource):\n    pass\n"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.path", [entry for entry in sys.path if entry])
    main(["scenes", "--source", "mine_in_a_folder:Mine:n_frames=3"])
    assert "toy-0" in capsys.readouterr().out
    main(["scenes", "preview", "mine_in_a_folder:Mine:n_frames=3", "--every", "1"])
    assert (tmp_path / "preview.gif").exists()


def test_scenes_lists_every_scene_of_the_split(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    main(["scenes", "--source", "town/calibration"])
    told = capsys.readouterr().out
    from cp_env.scenes import open_source

    source = open_source("town/calibration")
    assert f"town/calibration: {len(source.names())} scenes" in told
    for name in source.names():
        (row,) = (line for line in told.splitlines() if name in line)
        assert source.load(name).kind in row and str(source.load(name).n_frames) in row


def test_play_films_an_episode(toy_town: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "episode.gif"
    main(["play", "--defender", "none", "--action", "basis", "--max-frames", "3", "--out", str(out)])
    with Image.open(out) as film:
        assert film.format == "GIF" and film.n_frames == 3
    assert "3 frames, mean damage" in capsys.readouterr().out


def test_check_names_the_rules(toy_town: None, capsys: pytest.CaptureFixture[str]) -> None:
    main(["check", "--defender", "ego_only", "--action", "basis", "--rsu", "--max-frames", "2", "--steps", "3"])
    told = " ".join(capsys.readouterr().out.split())
    assert "26 rules kept: spaces_are_fixed" in told and "rendering_changes_nothing" in told


def test_the_cache_is_shown_bounded_and_cleared(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CP_ENV_CACHE", str(tmp_path))
    monkeypatch.setenv("COLUMNS", "200")
    bank = SceneBank(ToySource(n_frames=3), load_detector(), progress=False)
    for used, name in enumerate(("toy-0", "toy-1")):
        bank.episode(name, 2, False).encode()
        os.utime(bank.root / name, (1e9 + used, 1e9 + used))
    size = sum(path.stat().st_size for path in bank.root.rglob("*.maps"))

    def told(*args: str) -> str:
        main(["cache", *args])
        return capsys.readouterr().out

    (row,) = (line for line in told().splitlines() if bank.root.name in line)
    assert row.split()[:4] == ["toy", "Detector", "2", f"{size / 1e6:.1f}"]
    assert ["toy-0" in line or "toy-1" in line for line in told("--scenes").splitlines()].count(True) == 2
    assert "without a bound" in told()
    monkeypatch.setenv("CP_ENV_CACHE_SIZE", "5 GB")
    assert "bound 5000 MB" in told()
    assert f"{size / 2e6:.1f} MB of encoded scenes are left" in told("bound", f"{size * 0.7 / 1e6} MB")
    assert "toy-1" in told("--scenes") and "toy-0" not in told("--scenes"), "the one used last stays"
    (tmp_path / "mine.txt").write_text("not the library's")
    assert "MB deleted" in told("clear")
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]
    with pytest.raises(SystemExit, match="cp-env: a size is a number with"):
        main(["cache", "bound", "plenty"])


def test_bad_input_is_told_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match=r"cp-env: unknown scenes 'village'"):
        main(["scenes", "--source", "village"])
    with pytest.raises(SystemExit, match=r"cp-env: unknown defender 'prib' .did you mean 'prbi'"):
        main(["play", "--defender", "prib"])
    with pytest.raises(SystemExit, match="2"):
        main(["play", "--action", "raw"])
    assert "guided" in capsys.readouterr().err, "the choices are told"


def test_broken_scenes_are_left_out_by_a_flag(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    export(ToySource(n_frames=2), tmp_path / "set", layout="opv2v", frames=2, vehicles=2)
    folders = sorted(path for path in (tmp_path / "set").rglob("*") if path.is_dir() and list(path.glob("*.pcd")))
    sorted(folders[0].glob("*.pcd"))[0].write_bytes(b"not a point cloud")
    with pytest.raises(SystemExit, match=r"\.pcd"):
        main(["scenes", "preview", f"opv2v:{tmp_path / 'set'}", "--out", str(tmp_path / "film.gif")])
    main(["scenes", f"--source=opv2v:{tmp_path / 'set'}", "--skip-broken"])
    assert "left out scene" in capsys.readouterr().out
