"""Readings of PRBI's Algorithm 1 where its text leaves a choice that changes its figures."""

from __future__ import annotations

from dataclasses import dataclass

from defenders.checks import check_choice

SPLITS = ("once", "halves", "members", "replace")
ROUNDINGS = ("floor", "nearest", "ceiling")
MEANS = ("m", "floor")
TIES = ("random", "index")
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

    Under a perfect verifier, n = 5 (`python examples/reproduce/prbi_perfect.py --readings --episodes 500`), frames to
    convergence and MC rate (benign vehicles flagged, %) at k = 1, 2, 3, 4. No attacker is missed unless marked *:

        split     refresh  second/ties frames                    MC rate, %
        once      no       floor       3.01  3.81  3.71  3.62     0  17  20   0
        once      yes      floor       3.01  3.74  3.75  3.19     0  17  22   0
        halves    no       floor       3.01  3.81  3.27  2.67     0  17  22   0
        halves    yes      floor       3.01  3.74  3.28  3.18     0  17  26   0
        members   no       floor       3.01  3.84  3.27  2.81     0  17  22   0
        members   yes      floor       3.01  3.95  3.36  2.38     0  17  26   0
        replace   no       floor       3.01  4.15  4.36  4.43     0  15  18   0
        replace   yes      floor       3.01  4.00  4.37  4.00     0  15  22   0
        once      no       nearest *   2.57  2.81  2.59  2.48     6  18  20   0
        once      no       ceiling *   2.19  2.09  2.00  2.14    10  26  24   0
        once      no       by index    3.04  3.70  3.55  3.26     0  34  34   0
        the paper                      2.25  2.77  3.36  4.27     0   6   0   0

    With the second condition rounded otherwise than m itself, attackers are missed (25 to 61 %), which the paper never
    reports. Of the others the default has the least squared distance to the paper's frames. `mean` changes nothing at
    α = 0.01: with so wide a region of acceptance the second condition decides alone.
    """

    split: str = "once"
    refresh: bool = False
    second: str = "floor"
    mean: str = "m"
    ties: str = "random"

    def __post_init__(self) -> None:
        check_choice("split", self.split, SPLITS)
        check_choice("second", self.second, ROUNDINGS)
        check_choice("mean", self.mean, MEANS)
        check_choice("ties", self.ties, TIES)
