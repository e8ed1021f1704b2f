"""Failed episodes are counted by defender and kind, from records of which nothing else is left."""

from __future__ import annotations

from cp_env.evaluation import Run
from cp_env.evaluation.analysis.failed_episodes import failed_episodes
from tests.helpers.toy_evaluation import record


def test_like_failures_are_one_line() -> None:
    def broken(frame: int, why: str) -> str:
        return f"defender Halves failed in frame {frame}: {why}"

    key = "KeyError: 3, at mine.py:12 in inspect"
    first = {
        Run("mine:Halves", "none", 0, 0, ("a", "b")): [
            record("a", "1", 1, error=broken(2, key)),
            record("b", "1", 1, error=broken(7, key.replace("3", "4"))),
        ],
        Run("none", "none", 0, 0, ("a",)): [record("a", "1", 1)],
    }
    second = {
        Run("mine:Halves", "pgd", 2, 0, ("a", "b")): [
            record("a", "1", 1),
            record("b", "1", 1, error=broken(1, "ValueError: no\x1b[1m more")),
        ]
    }
    assert failed_episodes([first, second]) == (
        f"defender mine:Halves ended 2 of its 4 episodes: {key}",
        "defender mine:Halves ended 1 of its 4 episodes: ValueError: no?[1m more",
    )
    assert failed_episodes([{}]) == failed_episodes([]) == ()
