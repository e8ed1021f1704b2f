"""Boxes on a device give what `geometry.boxes` gives: IoU, pairs, suppression."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode

from cp_env.geometry import boxes as here
from cp_env.geometry.device_boxes import iou, overlaps, suppressed
from tests.cp_env.geometry.test_boxes import CAR, random_boxes
from tests.helpers.pretended_device import pretended


def sets(counts: list[int], seed: int = 0) -> tuple[list[np.ndarray], Tensor, Tensor]:
    """Sets of boxes, and the same padded, with a mask of the rows that count; what pads them is NaN."""
    arrays = [random_boxes(n, seed + n) for n in counts]
    rows = torch.full((len(counts), max(counts), 5), torch.nan, dtype=torch.float64)
    there = torch.arange(max(counts)) < torch.tensor(counts)[:, None]
    rows[there] = torch.from_numpy(np.concatenate(arrays))
    return arrays, rows, there


def test_iou_is_the_same() -> None:
    a, b = random_boxes(4000, 1), random_boxes(4000, 2)
    b[:50] = a[:50]
    b[50:60, 2] = 0.0
    found = iou(torch.from_numpy(a), torch.from_numpy(b)).numpy()
    assert found == pytest.approx(here.rotated_iou(a, b), abs=1e-12)
    assert found[:50] == pytest.approx(1.0) and not found[50:60].any()


def test_half_a_length_on_shares_a_third() -> None:
    a, b = torch.tensor([[0.0, 0, 4, 2, 0]]), torch.tensor([[2.0, 0, 4, 2, 0]])
    assert iou(a.double(), b.double()).item() == pytest.approx(4 / 12)


@pytest.mark.parametrize("above", [0.0, 0.3])
def test_pairs_are_the_same_and_in_the_same_order(above: float) -> None:
    a, padded_a, in_a = sets([5, 0, 12, 1])
    b, padded_b, in_b = sets([7, 3, 9, 0], seed=50)
    expected = here.overlaps(a, b, above)
    found = overlaps(padded_a, padded_b, in_a, in_b, above)
    for one, other in zip(found[:3], expected[:3], strict=True):
        assert one.tolist() == other.tolist()
    assert found[3].numpy() == pytest.approx(expected[3], abs=1e-12)


@pytest.mark.parametrize("above", [0.0, 0.15, 0.5])
def test_the_same_rows_stay(above: float) -> None:
    """Crowds, where chains of suppression are long."""
    arrays, rows, there = sets([40, 1, 25, 33])
    expected = [np.sort(here.nms(boxes, np.linspace(1, 0, len(boxes)), above)).tolist() for boxes in arrays]
    stays = suppressed(rows, there, above)
    assert [row.nonzero().flatten().tolist() for row in stays] == expected


def test_a_box_that_lost_suppresses_nobody() -> None:
    """A row of cars 1.2 m apart: each overlaps its neighbour by more than half, and the third stays."""
    row = torch.tensor([[[1.2 * i, 0, 4, 2, 0] for i in range(6)]]).double()
    assert suppressed(row, torch.ones(1, 6).bool(), 0.5).tolist() == [[True, False] * 3]


def test_only_boxes_that_count_must_be_finite() -> None:
    rows = torch.tensor([[CAR, [float("nan")] * 5]])
    assert suppressed(rows, torch.tensor([[True, False]]), 0.5).tolist() == [[True, False]]
    with pytest.raises(ValueError, match="boxes must be finite"):
        suppressed(rows, torch.tensor([[True, True]]), 0.5)


def test_nothing_is_nothing() -> None:
    none = torch.zeros(2, 0, 5), torch.zeros(2, 0).bool()
    assert suppressed(*none, 0.5).shape == (2, 0)
    assert [len(one) for one in overlaps(none[0], none[0], none[1], none[1])] == [0, 0, 0, 0]


class _Count(TorchDispatchMode):
    """How many operations were done."""

    operations = 0

    def __torch_dispatch__(self, func: object, types: object, args: object = (), kwargs: object = None) -> object:
        self.operations += 1
        return func(*args, **(kwargs or {}))  # type: ignore[operator]


@contextmanager
def counted() -> Iterator[_Count]:
    with _Count() as count:
        yield count


def test_more_views_are_no_more_operations() -> None:
    """No loop over views or rows: only the length of a chain adds any."""
    one = torch.tensor([[0.0, 0, 4, 2, 0], [1.2, 0, 4, 2, 0], [9, 9, 4, 2, 0]])
    counts = []
    for views in (1, 50):
        rows = one.expand(views, 3, 5)
        with counted() as count:
            suppressed(rows, torch.ones(views, 3).bool(), 0.5)
        counts.append(count.operations)
    assert counts[0] == counts[1]


def test_it_works_on_a_device() -> None:
    _, rows, there = sets([12, 7])
    expected = suppressed(rows, there, 0.2)
    with pretended():
        found = suppressed(rows.to("meta"), there.to("meta"), 0.2)
        assert found.device.type == "meta" and torch.equal(found.cpu(), expected)
