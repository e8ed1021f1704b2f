"""Flags on a leaderboard: results that no defender should reach.

A defender chooses among the maps that are shared; `none` fuses all of them. Without an attack, more average precision
than that of `none` comes from chance, or from knowing more than the maps say.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from cp_env.evaluation.analysis.summary import Row
from cp_env.evaluation.plan.runs import NO_ATTACK

DECIMALS = 2
"""To which AP is printed; a difference that nobody can see in the table is no flag. Our choice."""


def better_than_everyone(rows: Sequence[Row]) -> Iterator[str]:
    """A sentence for each defender whose AP@0.5 without an attack is above that of `none`, as both are printed."""
    clean = [row for row in rows if row.attack == NO_ATTACK]
    for everyone in (row for row in clean if row.defender == "none"):
        bound = round(everyone.ap50.mean, DECIMALS)
        for row in clean:
            reached = round(row.ap50.mean, DECIMALS)
            if row.n_episodes == everyone.n_episodes and reached > bound:
                yield (
                    f"{row.defender}: AP@.5 is {reached:.{DECIMALS}f} without an attack and {bound:.{DECIMALS}f} with "
                    "everyone fused. Chance, or it knows more than the maps say."
                )
