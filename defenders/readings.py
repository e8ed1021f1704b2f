"""What can be read into PRBI's Algorithm 1 where its text leaves a choice that changes its figures."""

from __future__ import annotations

from dataclasses import dataclass

SPLITS = ("once", "halves", "members", "replace")
ROUNDINGS = ("floor", "nearest", "ceiling")
MEANS = ("m", "floor")


@dataclass(frozen=True)
class Reading:
    """One way to read Algorithm 1. The defaults are what its lines say when taken one by one.

    split     what the divide and conquer adds to the counts (line 34, "Update c_normal, N, and c_abnormal"):
              "once"     as line 18 does: N + 1 for everyone, β + 1 for the subset found;
              "halves"   N + 1 for everyone after each pair of halves, β + 1 for halves that pass;
              "members"  as "halves", but N + 1 only for those who were verified, so that N differs between vehicles;
              "replace"  nothing to N: the subset's abnormal detection of this frame becomes a normal one.
    refresh   whether m and P_benign are evaluated again after the divide and conquer. Lines 20-26 stand before it and
              are not repeated, so: no.
    second    how m is rounded ("floor", "nearest", "ceiling") before the second condition compares it with the number
              of vehicles of probability zero.
    mean      what the mean of the window is compared with in Eq. (14): "m" of this frame, or "floor", ⌊m⌋.

    Measured under a perfect verifier, n = 5, 4,000 episodes a cell (`python examples/reproduce/prbi_perfect.py
    --readings`): frames to convergence, and the share of innocents convicted, at k = 1 / 2 / 3 / 4.

    READINGS_TABLE
    """

    split: str = "once"
    refresh: bool = False
    second: str = "floor"
    mean: str = "m"

    def __post_init__(self) -> None:
        check_choice("split", self.split, SPLITS)
        check_choice("second", self.second, ROUNDINGS)
        check_choice("mean", self.mean, MEANS)


def check_choice(name: str, value: object, known: tuple[str, ...]) -> None:
    """ValueError listing the known values unless `value` is one of them."""
    if value not in known:
        raise ValueError(f"{name} must be one of {', '.join(known)}; got {value!r}")
