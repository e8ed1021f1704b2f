"""Bad input gets a ValueError that states the rule, the value and the way out."""

from __future__ import annotations

from typing import Any

import pytest

from cp_env.settings import Settings


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"n_attackers": 5}, r"0 <= k < n: k = 5, n_vehicles = 5"),
        ({"n_attackers": -1}, r"0 <= k < n"),
        ({"n_vehicles": 1}, r"at least 2"),
        ({"attackers": (0, 0)}, r"distinct numbers"),
        ({"attackers": (5,)}, r"from 0 \(the ego\) to 4"),
        ({"attackers": (0, 1, 2, 3, 4)}, r"leave one vehicle benign"),
        ({"budget": -0.1}, r"budget Δ .* not -0.1"),
        ({"budget": float("nan")}, r"finite"),
        ({"max_frames": 0}, r"max_frames"),
        ({"grace_frames": -1}, r"grace_frames"),
        ({"action": "raw"}, r"action must be one of guided, stealth, basis, full, not 'raw'"),
        ({"fusion": "sum?"}, r"fusion must be one of .*, not 'sum\?'"),
        ({"observation": "x"}, r"observation must be one of features, compact"),
        ({"knowledge": "x"}, r"black-box, gray-box, white-box"),
        ({"reward": "x"}, r"damage, ap_drop, stealth"),
        ({"norm": "l1"}, r"linf, l2"),
        ({"slots": "x"}, r"adversaries, vehicles"),
    ],
)
def test_refuses(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Settings(**options)


def test_counts_attackers_and_maps() -> None:
    assert (Settings().k, Settings().n_maps) == (2, 5)
    assert (Settings(attackers=(0,), rsu=True).k, Settings(rsu=True).n_maps) == (1, 6)
