"""Bad input gets a ValueError that states the rule, the value and the way out."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from cp_env.settings import DEFAULTS, Settings
from tests.campaign.values import STRANGE


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"n_attackers": 5}, r"0 <= k < n: k = 5, n_vehicles = 5"),
        ({"n_attackers": -1}, r"0 <= k < n"),
        ({"n_vehicles": 1}, r"at least 2 \(an ego and a collaborator; 1 is enough with rsu=True\), not 1"),
        ({"n_vehicles": 0, "rsu": True}, r"at least 1 \(1 with the road-side unit\), not 0"),
        ({"n_vehicles": 1, "rsu": True}, r"k = 2, n_vehicles = 1 and the road-side unit"),
        ({"n_vehicles": 1, "rsu": True, "attackers": (0, 1)}, r"leave one vehicle benign: 2 of 2"),
        ({"attackers": (0, 0)}, r"distinct numbers"),
        ({"attackers": (5,)}, r"from 0 \(the ego\) to 4"),
        ({"attackers": (0, 1, 2, 3, 4)}, r"leave one vehicle benign"),
        ({"budget": -0.1}, r"budget Δ .* not -0.1"),
        ({"budget": float("nan")}, r"finite"),
        ({"max_frames": 0}, r"max_frames"),
        ({"grace_frames": -1}, r"grace_frames"),
        ({"action": "raw"}, r"action must be one of guided, stealth, critical, basis, full, not 'raw'"),
        ({"fusion": "sum?"}, r"fusion must be one of .*, not 'sum\?'"),
        ({"observation": "x"}, r"observation must be one of features, compact"),
        ({"knowledge": "x"}, r"black-box, gray-box, white-box"),
        ({"reward": "x"}, r"damage, ap_drop, stealth"),
        ({"norm": "l1"}, r"linf, l2"),
        ({"slots": "x"}, r"adversaries, vehicles"),
        ({"n_vehicles": 10**9}, r"n_vehicles must be at most 1024, not 1000000000"),
        ({"attackers": range(10**9)}, r"distinct numbers from 0 \(the ego\) to 4, not range\(0, 1000000000\)"),
        ({"attackers": np.array(3)}, r"a sequence of vehicle numbers such as \(0, 3\), not array\(3\)"),
    ],
)
def test_refuses(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Settings(**options)


def refusal(name: str, value: Any) -> str:
    """What the settings say against a value; empty if they take it."""
    try:
        Settings.of({name: value})
    except ValueError as error:
        return str(error)
    return ""


@pytest.mark.parametrize("name", [name for name in DEFAULTS if name in Settings.__dataclass_fields__])
def test_strange_values_are_taken_or_refused_in_a_sentence(name: str) -> None:
    """Whatever raises in a conversion, has no end, or is deeper than Python writes: a `ValueError` of some lines."""
    refusals = [said for make in STRANGE if (said := refusal(name, make()))]
    assert len(refusals) > len(STRANGE) / 2
    assert all(name in said or "attackers" in said for said in refusals)
    assert max(map(len, refusals)) < 600


def test_one_vehicle_and_the_road_side_unit_are_enough() -> None:
    """Either may be malicious, so attackers are drawn from both; beside more vehicles the unit is never drawn."""
    alone = Settings(n_vehicles=1, n_attackers=1, rsu=True)
    assert (alone.n_maps, alone.n_suspects, alone.k) == (2, 2, 1)
    assert Settings(n_vehicles=1, attackers=(1,), rsu=True).attackers == (1,)
    assert (Settings(rsu=True).n_suspects, Settings(n_vehicles=2, n_attackers=1).n_suspects) == (5, 2)


def test_counts_attackers_and_maps() -> None:
    assert (Settings().k, Settings().n_maps) == (2, 5)
    assert (Settings(attackers=(0,), rsu=True).k, Settings(rsu=True).n_maps) == (1, 6)
