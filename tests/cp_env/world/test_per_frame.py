"""Values a frame are computed when they are asked for, once if they are kept."""

from __future__ import annotations

import pytest

from cp_env.world.per_frame import PerFrame


@pytest.mark.parametrize(("keep", "computed"), [(True, [2, 3]), (False, [2, 2, 2, 3])])
def test_only_what_is_asked_for_is_computed(keep: bool, computed: list[int]) -> None:
    asked: list[int] = []

    def square(t: int) -> int:
        asked.append(t)
        return t * t

    squares = PerFrame(4, square, keep=keep)
    assert len(squares) == 4 and not asked
    assert [squares[2], squares[-2], squares[2], squares[3]] == [4, 4, 4, 9]
    assert asked == computed


def test_it_ends() -> None:
    doubled = PerFrame(3, lambda t: 2 * t)
    assert list(doubled) == [0, 2, 4]
    for frame in (3, -4):
        with pytest.raises(IndexError, match=f"frame {frame} of a scene of 3 frames"):
            doubled[frame]
