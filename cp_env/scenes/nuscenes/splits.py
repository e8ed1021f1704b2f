"""The official splits of nuScenes, by the numbers in the scenes' names (`create_splits_scenes` of its devkit)."""

from __future__ import annotations

import re
from collections.abc import Sequence

from defenders.registry import unknown

SPLITS = ("all", "train", "val", "mini_train", "mini_val")


def _numbers(ranges: str) -> frozenset[int]:
    ends = [part.partition("-") for part in ranges.split()]
    return frozenset(n for a, dash, b in ends for n in range(int(a), int(b if dash else a) + 1))


VAL = _numbers(
    "3 12-18 35-36 38-39 92-110 221 268-278 329-332 344-346 519-524 552-565 625-627 629-630 632-638 770-771 775 "
    "777-778 780-784 794-800 802 904-917 919-931 962-963 966-969 971-972 1059-1073"
)
TEST = _numbers(
    "77-91 111-119 140 142-148 265-266 279-282 307-314 333-343 481-498 547-551 601-604 606-624 827-831 833-842 844-846 "
    "932-933 935-943 1026-1043"
)
MINI = _numbers("61 103 553 655 757 796 916 1077 1094 1100")
MINI_VAL = _numbers("103 916")


def in_split(number: int, split: str) -> bool:
    """Whether scene `number` belongs to `split`; train is all that is in no other.

    Raises:
        ValueError: an unknown split, or "test", whose boxes are not published.
    """
    if split == "test":
        raise ValueError("split test of nuScenes has no published boxes: use one of " + ", ".join(SPLITS))
    if split not in SPLITS:
        raise unknown("split", split, SPLITS)
    if split == "all":
        return True
    if split.startswith("mini"):
        return number in MINI and (number in MINI_VAL) == (split == "mini_val")
    return number not in TEST and (number in VAL) == (split == "val")


def choose(names: Sequence[str], split: str, scenes: Sequence[str]) -> tuple[int, ...]:
    """Places in `names` of the scenes of a split, only those that `scenes` names (or numbers) if it names any.

    Raises:
        ValueError: unknown split, a name without a number, a scene that is not there or not in the split, or none left.
    """
    ends = [re.search(r"\d+$", name) for name in names]
    if None in ends:
        raise ValueError(f"scene {names[ends.index(None)]!r} has no number at its end, as in scene-0061")
    numbers = [int(found[0]) for found in ends if found]
    mine = [place for place, number in enumerate(numbers) if in_split(number, split)]
    if not mine:
        raise ValueError(f"split {split!r} has none of the set's {len(names)} scenes: is it in another version=?")
    labels = {label: place for place in mine for label in (names[place], str(numbers[place]))}
    if absent := [scene for scene in scenes if scene not in labels]:
        raise ValueError(f"scene {absent[0]!r} is not in split {split!r} of the set, which holds {len(mine)} scenes")
    return tuple(dict.fromkeys(labels[scene] for scene in scenes)) or tuple(mine)
