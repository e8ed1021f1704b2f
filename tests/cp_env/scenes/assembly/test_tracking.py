"""Vehicles followed without numbers: by place, pace and size."""

from __future__ import annotations

import numpy as np
import pytest

from cp_env.scenes.assembly.tracking import follow


def box(x: float, y: float = 0.0, length: float = 4.0, width: float = 2.0) -> list[float]:
    return [x, y, length, width, 0.0]


def frames(*rows: list[list[float]]) -> list[np.ndarray]:
    return [np.array(row, dtype=np.float64).reshape(-1, 5) for row in rows]


def test_two_that_pass_each_other_are_told_apart_by_their_pace() -> None:
    """They meet in the middle of the third frame, 0.2 m apart; each goes on as it came."""
    ways = [(4.0 * t, 16.2 - 4.0 * t) for t in range(5)]
    order = [(0, 1), (1, 0), (0, 1), (1, 0), (0, 1)]
    seen = frames(*([box(way[k]) for k in swap] for way, swap in zip(ways, order, strict=True)))
    tracks = follow(seen, reach=5.0)
    assert len(tracks) == 2
    for track in tracks:
        path = [seen[t][b][0] for t, b in track.items()]
        assert np.allclose(np.diff(path), np.diff(path)[0])


def test_sizes_and_distances_decide() -> None:
    seen = frames([box(0), box(10, length=8.0)], [box(10.5), box(0.5, length=8.0)], [])
    assert follow(seen, reach=5.0) == [{0: 0}, {0: 1}, {1: 0}, {1: 1}], "nobody changes size, nobody jumps"
    assert follow(seen, reach=20.0) == [{0: 0, 1: 0}, {0: 1, 1: 1}]
    assert follow(seen, reach=5.0, alike=5.0) == [{0: 0, 1: 1}, {0: 1, 1: 0}]


@pytest.mark.parametrize("seed", range(3))
def test_every_box_is_in_one_track(seed: int) -> None:
    rng = np.random.default_rng(seed)
    seen = [
        np.column_stack([rng.uniform(-30, 30, (n, 2)), np.tile([4.0, 2, 0], (n, 1))]) for n in rng.integers(0, 9, 12)
    ]
    tracks = follow(seen, reach=8.0)
    pairs = [pair for track in tracks for pair in track.items()]
    assert sorted(pairs) == [(t, b) for t, there in enumerate(seen) for b in range(len(there))]
    assert all(np.diff(list(track)).tolist() == [1] * (len(track) - 1) for track in tracks), "no track has a gap"
