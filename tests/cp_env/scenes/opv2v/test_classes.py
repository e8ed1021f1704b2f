"""What is a vehicle, by its type's name in any case of letters."""

from __future__ import annotations

import pytest

from cp_env.scenes.opv2v.classes import CLASSES, DEFAULT, Choice, plain


def test_no_type_is_in_two_groups_and_all_are_written_as_compared() -> None:
    names = [name for group in CLASSES.values() for name in group]
    assert len(set(names)) == len(names) and all(plain(name) == name for name in names)


@pytest.mark.parametrize(
    ("kind", "counts"),
    [
        (None, True), ("Car", True), ("CAR", True), ("Pickup Truck", True), ("Semi-truck", True), ("LongVehicle", True),
        ("police_car", True), ("Pedestrian", False), ("MotorcyleRider", False), ("TrashCan", False), ("bin", False),
    ],
)  # fmt: skip
def test_only_vehicles_are_vehicles(kind: str | None, counts: bool) -> None:
    assert Choice.of(DEFAULT).counts(kind) is counts


def test_groups_and_types_are_chosen() -> None:
    choice = Choice.of(("vehicle", "two-wheeler", "-Bus", "Child"))
    assert [choice.counts(kind) for kind in ("car", "BUS", "Cyclist", "child", "pedestrian")] == [1, 0, 1, 1, 0]
    only = Choice.of(("car",))
    assert only.counts("Car") and not only.counts("van") and only.counts(None), "what has no type is a vehicle"


def test_an_unknown_type_is_told_and_may_be_decided() -> None:
    with pytest.raises(ValueError, match=r"'Pedestrain'.*did you mean.*pedestrian.*classes=vehicle,-pedestrain"):
        Choice.of(DEFAULT).counts("Pedestrain")
    assert Choice.of(("vehicle", "hovercraft")).counts("HoverCraft")
    assert not Choice.of(("vehicle", "-hovercraft")).counts("HoverCraft")


@pytest.mark.parametrize("names", [(), ("-car",), ("",), ("car van!",), ("vehicle", "-")])
def test_a_choice_of_nothing_is_refused(names: tuple[str, ...]) -> None:
    with pytest.raises(ValueError, match="classes must name groups"):
        Choice.of(names)
