"""Checks of options that several defenders share."""

from __future__ import annotations

from collections.abc import Collection


def check_choice(name: str, value: object, known: tuple[str, ...]) -> None:
    """ValueError listing the known values unless `value` is one of them."""
    if value not in known:
        raise ValueError(f"{name} must be one of {', '.join(known)}; got {value!r}")


def check_paid(
    uncounted: Collection[frozenset[int]],
    counted: Collection[frozenset[int]],
    output: frozenset[int],
    everyone: frozenset[int],
) -> None:
    """Hold the groups that a defender was shown without paying against the rule of every referee.

    Free are everyone's view, the output's group, and one single-vehicle reference a frame.

    Args:
        uncounted: groups that were queried with `verification=False` in this frame.
        counted: groups that were queried as verifications.
        output: the group that is fused for the output.
        everyone: all vehicles that are present.

    Raises:
        ValueError: more than that was queried without paying.
    """
    unpaid = set(uncounted) - set(counted) - {output, everyone}
    singles = {group for group in unpaid if len(group) == 1}
    if len(singles) > 1 or unpaid != singles:
        shown = ", ".join(str(sorted(group)) for group in sorted(unpaid, key=sorted))
        raise ValueError(
            f"{len(unpaid)} groups were queried with verification=False and are not the output: {shown}. Free are "
            "everyone's view, the output's group and one single-vehicle reference a frame; pay for the rest"
        )
