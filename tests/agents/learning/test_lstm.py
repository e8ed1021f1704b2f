"""The memory of a recurrent policy against torch's own cell."""

from __future__ import annotations

import pytest
import torch

from agents.learning.lstm import Memory

D, H, N = 3, 4, 5


@pytest.fixture
def cell() -> torch.nn.LSTMCell:
    with torch.random.fork_rng():
        torch.manual_seed(0)
        return torch.nn.LSTMCell(D, H)


@pytest.fixture
def memory(cell: torch.nn.LSTMCell) -> Memory:
    return Memory(*(w.detach() for w in (cell.weight_ih, cell.weight_hh, cell.bias_ih, cell.bias_hh)))


def frames(n: int = 6) -> torch.Tensor:
    return torch.randn(n, N, D, generator=torch.Generator().manual_seed(1))


@torch.no_grad()
def test_it_remembers_as_torchs_cell_does(cell: torch.nn.LSTMCell, memory: Memory) -> None:
    state = torch.zeros(N, H), torch.zeros(N, H)
    for frame in frames():
        state = cell(frame, state)
        torch.testing.assert_close(memory(frame), state[0], rtol=1e-5, atol=1e-6)


def test_the_past_matters_until_it_is_forgotten(memory: Memory) -> None:
    one, two = frames(2)
    fresh = memory(two)
    memory.reset()
    memory(one)
    assert not torch.allclose(memory(two), fresh)
    memory.reset()
    assert torch.equal(memory(two), fresh)


def test_environments_do_not_share_what_they_remember(memory: Memory) -> None:
    together = [memory(frame)[2:3] for frame in frames()]
    memory.reset()
    for frame, expected in zip(frames(), together, strict=True):
        torch.testing.assert_close(memory(frame[2:3]), expected, rtol=1e-5, atol=1e-6)


def test_another_number_of_environments_asks_for_a_reset(memory: Memory) -> None:
    memory(frames()[0])
    with pytest.raises(ValueError, match=r"5 .*not 2: reset"):
        memory(frames()[0, :2])
    memory.reset()
    assert memory(frames()[0, :2]).shape == (2, H)
