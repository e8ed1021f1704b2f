"""What is a vehicle: classes of objects by their `obj_type`, in any case of letters.

A name is compared without blanks, hyphens and underscores: "Pickup Truck" is `pickuptruck`. An object without a type is
a vehicle: OPV2V and V2XSet list nothing else.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

from defenders.registry import unknown

CLASSES: dict[str, tuple[str, ...]] = {
    "vehicle": (
        "vehicle", "car", "policecar", "taxi", "suv", "van", "minivan", "pickup", "pickuptruck", "truck",
        "concretetruck", "firetruck", "semitruck", "semi", "trailer", "longvehicle", "bus", "ambulance",
    ),
    "two-wheeler": (
        "bicycle", "bicyclerider", "cyclist", "motorcycle", "motorcyclerider", "motorcylerider", "motorcyclist",
        "scooter", "scooterrider", "tricycle", "tricyclist",
    ),
    "pedestrian": ("pedestrian", "person", "walker", "child", "roadworker"),
    "other": ("trashcan", "bin", "firehydrant", "constructioncart", "barrow", "barrowlist", "trafficcone", "cone",
              "barrier"),
}  # fmt: skip
"""Groups and the types in them, as V2X-Real ("MotorcyleRider" is its spelling), V2V4Real and DAIR-V2X name them."""

DEFAULT = ("vehicle",)
_GROUP = {name: group for group, names in CLASSES.items() for name in names}


def plain(name: str) -> str:
    """A type's name as it is compared."""
    return re.sub(r"[\s_-]+", "", name).lower()


@dataclass(frozen=True)
class Choice:
    """Which objects count as vehicles."""

    groups: frozenset[str]
    kept: frozenset[str]  # types chosen by name
    dropped: frozenset[str]

    @classmethod
    def of(cls, names: Iterable[str]) -> Choice:
        """Read a choice.

        Args:
            names: groups of `CLASSES`, single types, and types with a leading "-", which are left out. A type need not
                be in the table.

        Raises:
            ValueError: nothing is chosen, or a name is no word.
        """
        texts = [str(name).strip() for name in names]
        groups = frozenset(text for text in texts if text in CLASSES)
        kept = frozenset(plain(text) for text in texts if text not in CLASSES and not text.startswith("-"))
        dropped = frozenset(plain(text[1:]) for text in texts if text.startswith("-"))
        if not groups | kept or not all(re.fullmatch(r"\w+", name) for name in kept | dropped):
            raise ValueError(
                f"classes must name groups ({', '.join(CLASSES)}) or types such as car, a leading - leaves one out: "
                f"got {','.join(texts)!r}"
            )
        return cls(groups, kept, dropped)

    def counts(self, kind: str | None) -> bool:
        """Whether an object of this type is a vehicle.

        Args:
            kind: its `obj_type`, None if the file gives none.

        Raises:
            ValueError: the type is in no group, and neither chosen nor left out by name.
        """
        if kind is None:
            return True
        name = plain(kind)
        if name in self.dropped or name in self.kept:
            return name in self.kept and name not in self.dropped
        if name not in _GROUP:
            raise ValueError(
                f"{unknown('obj_type', kind, sorted(_GROUP))}; count it as a vehicle with classes=vehicle,{name}, "
                f"or leave it out with classes=vehicle,-{name}"
            )
        return _GROUP[name] in self.groups
