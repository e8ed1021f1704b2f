"""The official splits of V2X-Sim 2.0, by scene number (coperception's `v2x_sim_scene_split`); train is all the rest."""

from __future__ import annotations

import re
from collections.abc import Sequence

SPLITS = ("all", "train", "val", "test")
WHOLE = 100  # scenes
_TEST = frozenset({5, 8, 19, 27, 28, 29, 91, 92, 96, 97})
_VAL = frozenset({1, 3, 4, 63, 65, 68, 76, 78, 79, 84})


def in_split(number: int, split: str) -> bool:
    """Whether scene `number` belongs to `split`; ValueError for an unknown split."""
    if split not in SPLITS:
        raise ValueError(f"split must be one of {', '.join(SPLITS)}; got {split!r}")
    home = "test" if number in _TEST else "val" if number in _VAL else "train"
    return split in ("all", home)


def numbered(names: Sequence[str]) -> tuple[int, ...]:
    """The number of each scene: its place in the whole set; in a part of the set, the number its name ends with.

    The official splits count places. Places it is, too, where the names do not end with different numbers.
    """
    ends = [int(found[0]) for name in names if (found := re.search(r"\d+$", name))]
    if len(names) == WHOLE or len(set(ends)) < len(names):
        return tuple(range(len(names)))
    return tuple(ends)


def choose(names: Sequence[str], split: str, scenes: Sequence[str]) -> tuple[int, ...]:
    """Places in `names` of the scenes of a split, only those that `scenes` names (or numbers) if it names any.

    Raises:
        ValueError: unknown split, a scene that is not there or not in the split, or none left.
    """
    numbers = numbered(names)
    mine = [place for place, number in enumerate(numbers) if in_split(number, split)]
    if not mine:
        raise ValueError(f"split {split!r} has none of the set's scenes ({', '.join(names)}); use split=all")
    labels = {label: place for place in mine for label in (names[place], str(numbers[place]))}
    unknown = [scene for scene in scenes if scene not in labels]
    if unknown:
        known = ", ".join(names[place] for place in mine)
        raise ValueError(f"scene {unknown[0]!r} is not in split {split!r} of the set, which holds {known}")
    return tuple(dict.fromkeys(labels[scene] for scene in scenes)) or tuple(mine)
