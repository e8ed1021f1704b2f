"""The options that all programs of many runs share: scenes spread evenly, and the key of a hidden benchmark."""

from __future__ import annotations

from pathlib import Path

import pytest

from agents.arena.conditions import CommonOptions, read_key, spread


def test_scenes_are_spread_evenly() -> None:
    assert spread("abcdef", 3) == ("a", "c", "e")
    assert spread("abc", None) == ("a", "b", "c")
    with pytest.raises(ValueError, match="n_scenes must be 1 to 3, not 4"):
        spread("abc", 4)


def test_the_road_side_unit_is_one_option_of_all() -> None:
    assert not CommonOptions().on_scenes().rsu
    assert CommonOptions(rsu=True).on_scenes().settings(1).n_maps == 6


def test_a_key_is_read_from_its_file_and_a_short_one_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "key.txt"
    path.write_text("k" * 40 + "\n")
    assert read_key(path) == "k" * 40
    assert CommonOptions(key=path).on_scenes().key == "k" * 40
    assert CommonOptions().on_scenes().describe() == CommonOptions(sealed=False).on_scenes().describe()
    path.write_text("k" * 31)
    with pytest.raises(ValueError, match="31 characters and could be guessed"):
        read_key(path)
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ValueError, match="cannot read the key"):
        read_key(path)
    with pytest.raises(ValueError, match="cannot read the key"):
        read_key(tmp_path / "absent.txt")
