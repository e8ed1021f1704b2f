"""The official splits: counts, and scenes that the devkit lists."""

from __future__ import annotations

import pytest

from cp_env.scenes.nuscenes import splits
from cp_env.scenes.nuscenes.splits import choose, in_split


def test_their_sizes_are_the_papers() -> None:
    """700, 150 and 150 scenes; the mini set has eight and two."""
    assert len(splits.VAL) == len(splits.TEST) == 150 and not splits.VAL & splits.TEST
    assert len(splits.MINI) == 10 and splits.MINI_VAL < splits.MINI and not splits.MINI & splits.TEST


@pytest.mark.parametrize(
    ("split", "inside", "outside"),
    [
        ("train", (1, 2, 61, 655, 1110), (3, 77, 1073, 916)),
        ("val", (3, 12, 110, 221, 553, 916, 1073), (1, 77, 918, 111)),
        ("mini_train", (61, 553, 655, 757, 796, 1077, 1094, 1100), (103, 916, 1)),
        ("mini_val", (103, 916), (61, 1)),
        ("all", (1, 3, 77), ()),
    ],
)
def test_scenes_of_the_devkits_lists(split: str, inside: tuple[int, ...], outside: tuple[int, ...]) -> None:
    assert all(in_split(number, split) for number in inside)
    assert not any(in_split(number, split) for number in outside)


def test_scenes_are_chosen_by_name_and_number() -> None:
    names = ["scene-0061", "scene-0103", "scene-0553", "scene-0916"]
    assert choose(names, "mini_val", ()) == (1, 3)
    assert choose(names, "val", ("916", "scene-0553", "916")) == (3, 2)
    for given, told in (
        (("test", ()), "split test of nuScenes has no published boxes"),
        (("mini", ()), r"unknown split 'mini' .did you mean 'mini_"),
        (("val", ("61",)), "scene '61' is not in split 'val'"),
    ):
        with pytest.raises(ValueError, match=told):
            choose(names, *given)
    with pytest.raises(ValueError, match="none of the set's 1 scenes: is it in another version"):
        choose(["scene-0061"], "val", ())
    with pytest.raises(ValueError, match="scene 'toy' has no number at its end"):
        choose(["scene-0061", "toy"], "all", ())
