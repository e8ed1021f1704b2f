"""How well a defence identifies attackers, and how much of the lost AP it restores."""

from __future__ import annotations

from collections.abc import Collection


def id_rate(suspects: Collection[int], attackers: Collection[int]) -> float:
    """ID rate (true positive rate): share of the attackers that are flagged; 1 if there is none."""
    return len(set(suspects) & set(attackers)) / len(set(attackers)) if attackers else 1.0


def mc_rate(suspects: Collection[int], attackers: Collection[int], n: int) -> float:
    """MC rate (false positive rate): share of the benign of vehicles 0 … n-1 that are flagged; 0 if none is benign."""
    benign = set(range(n)) - set(attackers)
    return len(set(suspects) & benign) / len(benign) if benign else 0.0


def recovery(ap: float, attacked: float, clean: float) -> float:
    """Share of the AP lost to an attack that a defence restores: (ap - attacked) / (clean - attacked).

    Below 0 where the defence does more harm than the attack, above 1 where it beats the clean value. If the attack cost
    nothing (clean <= attacked) there is nothing to restore: 1 if `ap` is at least the clean value, else 0.
    """
    loss = clean - attacked
    if loss <= 0:
        return 1.0 if ap >= clean else 0.0
    return (ap - attacked) / loss
