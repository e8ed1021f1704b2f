"""The official splits: a file that the user has."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from cp_env.scenes.dair_v2x.splits import NAME, find_split_file, plain, read_split
from cp_env.scenes.errors import BrokenData


def write(folder: Path, said: object) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / NAME).write_text(json.dumps(said))
    return folder / NAME


def test_it_is_found_in_the_folder_and_above_it(tmp_path: Path) -> None:
    root = tmp_path / "data/DAIR/inner"
    root.mkdir(parents=True)
    with pytest.raises(BrokenData, match=r"is missing: github\.com/AIR-THU/DAIR-V2X.*split_file=, or use split=all"):
        find_split_file(root, None)
    for folder in (root.parent.parent, root.parent, root):
        file = write(folder, {})
        assert find_split_file(root, None) == file
    assert find_split_file(root, "elsewhere.json") == Path("elsewhere.json")


def test_numbers_are_compared_without_zeros(tmp_path: Path) -> None:
    file = write(tmp_path, {"cooperative_split": {"train": ["000010", "7"], "val": [], "test_A": ["0"]}})
    assert read_split(file, "train") == {"10", "7"} and read_split(file, "val") == frozenset()
    assert plain("000") == plain("0") == "0"
    with pytest.raises(ValueError, match=r"unknown split 'trian' .did you mean 'train'"):
        read_split(file, "trian")


@pytest.mark.parametrize(
    ("said", "told"),
    [({}, "holds no table cooperative_split"), ([], "holds no table"), ({"cooperative_split": []}, "holds no table")],
)
def test_other_files_are_named(tmp_path: Path, said: object, told: str) -> None:
    with pytest.raises(BrokenData, match=told):
        read_split(write(tmp_path, said), "train")
    with pytest.raises(BrokenData, match="cannot be read"):
        read_split(tmp_path / "nothing.json", "train")
    with pytest.raises(BrokenData, match="is no list of numbers"):
        read_split(write(tmp_path, {"cooperative_split": {"train": 5}}), "train")
