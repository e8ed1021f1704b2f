"""Readings of PRBI's Algorithm 1 where its text leaves a choice that changes its figures."""

from __future__ import annotations

from dataclasses import dataclass

from defenders.checks import check_choice

SPLITS = ("once", "halves", "members", "replace")
ROUNDINGS = ("floor", "nearest", "ceiling")
MEANS = ("m", "floor")
TIES = ("random", "index")
FIRSTS = ("m", "even", "independent")
FLAGGED = ("rounded", "zeros")
STOPPINGS = ("paper", "never")


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
    ties      how vehicles of equal P_benign are ordered in argsort: at "random", anew in every frame, or by "index".

    first     how the first abnormal frame divides the fleet, which has no P_benign yet:
              "m"     as lines 2 and 13 say: m = n - 1, so one vehicle is apart from all others;
              "even"  at random, at a size drawn evenly from 1 … n - 1 (Sec. 4.1: "two random groups per frame");
              "independent"  each vehicle joins either group with probability 1/2; an empty group is left out.
              The divide and conquer of "even" and "independent" follows the drawn order.
    flagged   the Attackers of Eq. (13): the "rounded" m vehicles at the head of argsort, or the "zeros", all vehicles
              of probability zero ("β_j must be 0", Sec. 4.3). They differ while `second` rounds otherwise than m.

    What each reading does under a perfect verifier is the table "Readings" of docs/prbi.md
    (`python examples/reproduce/prbi_perfect.py --readings`). None gives all figures of the paper. `mean` changes
    nothing at α = 0.01: with so wide a region of acceptance the second condition decides alone.

    Raises:
        ValueError: an option that is none of the above.
    """

    split: str = "once"
    refresh: bool = False
    second: str = "floor"
    mean: str = "m"
    ties: str = "random"
    first: str = "m"
    flagged: str = "rounded"

    def __post_init__(self) -> None:
        check_choice("split", self.split, SPLITS)
        check_choice("second", self.second, ROUNDINGS)
        check_choice("mean", self.mean, MEANS)
        check_choice("ties", self.ties, TIES)
        check_choice("first", self.first, FIRSTS)
        check_choice("flagged", self.flagged, FLAGGED)
