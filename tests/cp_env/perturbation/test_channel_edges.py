"""What the ego receives is F + δ, Eq. (1): maps that are not zero keep what they were."""

from __future__ import annotations

import torch
from hypothesis import given
from hypothesis import strategies as st

from cp_env.perturbation.channel import inject


@given(st.integers(1, 4), st.integers(1, 5), st.data())
def test_injecting_is_adding_row_by_row(n_worlds: int, n_maps: int, data: st.DataObject) -> None:
    k = data.draw(st.integers(1, n_maps))
    attackers = torch.tensor([data.draw(st.permutations(range(n_maps)))[:k] for _ in range(n_worlds)])
    received, warped = torch.randn(n_worlds, n_maps, 2, 3, 3), torch.randn(n_worlds, k, 2, 3, 3)
    expected = received.clone()
    for e, row in enumerate(attackers.tolist()):
        for i, attacker in enumerate(row):
            expected[e, attacker] += warped[e, i]
    torch.testing.assert_close(inject(received, warped, attackers), expected)
