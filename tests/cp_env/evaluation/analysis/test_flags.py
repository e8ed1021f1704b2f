"""Flags: more AP than everyone's maps give, without an attack."""

from __future__ import annotations

from cp_env.evaluation.analysis.flags import better_than_everyone
from tests.helpers.toy_evaluation import record, rows_of

CLEAN = {"attackers": ()}
RESULTS = {
    "none": "110",
    "same": "110",
    "worse": "100",
    "clever": "111",
}
"""Of three vehicles, which of the boxes are right, the best score first."""


def test_only_a_defender_that_finds_more_than_everyone_fused_is_flagged() -> None:
    groups = {f"{name}__none": [record("a", hits, 3, **CLEAN)] for name, hits in RESULTS.items()}
    rows = list(rows_of(**groups).values())
    (flag,) = better_than_everyone(rows)
    assert flag.startswith("clever: AP@.5 is 1.00 without an attack and 0.67 with everyone fused")


def test_rows_under_an_attack_or_of_other_episodes_are_not_compared() -> None:
    attacked = {"none__pgd": [record("a", "100", 3)], "clever__pgd": [record("a", "111", 3)]}
    assert not list(better_than_everyone(list(rows_of(**attacked).values())))
    unequal = {
        "none__none": [record("a", "100", 3, **CLEAN)],
        "clever__none": [record("a", "111", 3, **CLEAN), record("b", "111", 3, **CLEAN)],
    }
    assert not list(better_than_everyone(list(rows_of(**unequal).values())))
