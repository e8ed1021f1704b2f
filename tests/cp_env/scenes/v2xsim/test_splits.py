"""The official splits, by scene number."""

from __future__ import annotations

import pytest

from cp_env.scenes.v2xsim.splits import choose


def test_official_splits() -> None:
    names = [f"scene_{k}" for k in range(1, 101)]  # whatever they are called, places count in the whole set
    test, val, train = (choose(names, split, ()) for split in ("test", "val", "train"))
    assert test == (5, 8, 19, 27, 28, 29, 91, 92, 96, 97) and val == (1, 3, 4, 63, 65, 68, 76, 78, 79, 84)
    assert sorted((*test, *val, *train)) == list(range(100)) == list(choose(names, "all", ()))
    assert choose(names, "test", ("8", "5", "scene_98")) == (8, 5, 97)
    part = ["scene_8", "scene_2", "scene_96"]  # in a part of the set, the names do
    assert choose(part, "test", ()) == (0, 2) and choose(part, "train", ("2",)) == (1,)
    with pytest.raises(ValueError, match=r"'1' is not in split 'test'.*scene_6"):
        choose(names, "test", ("1",))
    with pytest.raises(ValueError, match="use split=all"):
        choose(part, "val", ())
    with pytest.raises(ValueError, match="all, train, val, test"):
        choose(names, "testing", ())
