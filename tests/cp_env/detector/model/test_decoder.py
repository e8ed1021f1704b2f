"""Peaks of a dense output, worked by hand."""

from __future__ import annotations

import math

import pytest
import torch

from cp_env.detector.model.decoder import Decoder, Dense, _highest, cell_centres, peaks


def dense(size: int = 4, **logits: float) -> Dense:
    """One view of `size` cells a side in which nothing is seen but at the cells named `r<row>c<column>`."""
    heights = torch.full((1, size, size), -9.0)
    for cell, logit in logits.items():
        heights[0, int(cell[1]), int(cell[3])] = logit
    return Dense(heights, torch.zeros(1, 6, size, size))


def test_cells_lie_in_the_middle_of_their_share() -> None:
    assert cell_centres(4, 2.0, torch.zeros(1)).tolist() == [-1.5, -0.5, 0.5, 1.5]


def test_a_peak_by_hand() -> None:
    """Row 3 is y = 1.5 m and column 0 x = -1.5 m; the code moves the box by (0.3, -0.2) m and turns it by 0.4 rad."""
    found = dense(r3c0=2.0)
    code = [0.3, -0.2, math.log(4.5), math.log(1.8), math.sin(0.8), math.cos(0.8)]
    found.boxes[0, :, 3, 0] = torch.tensor(code)
    scores, boxes = peaks(found, 0.1, 2.0, 2)
    assert scores[0].tolist() == pytest.approx([1 / (1 + math.exp(-2.0)), 0.0])
    assert boxes[0, 0].tolist() == pytest.approx([-1.2, 1.3, 4.5, 1.8, 0.4])


def test_a_neighbour_is_no_peak_and_a_cell_two_away_is() -> None:
    scores, boxes = peaks(dense(size=6, r1c1=2.0, r2c2=1.0, r4c4=1.0, r1c5=0.5), 0.5, 3.0, 36)
    assert (scores > 0).sum() == 3
    assert boxes[0, :3, :2].tolist() == [[-1.5, -1.5], [1.5, 1.5], [2.5, -1.5]]


def test_the_floor_is_a_score_that_still_counts() -> None:
    floor = torch.tensor(1.0).sigmoid().item()
    assert (peaks(dense(r0c0=1.0001, r2c2=0.9999), floor, 2.0, 16)[0] > 0).sum() == 1


def test_no_more_than_asked_and_the_best_first() -> None:
    scores, _ = peaks(dense(r0c0=0.5, r0c2=2.0, r2c0=1.0), 0.1, 2.0, 2)
    assert scores[0].tolist() == pytest.approx([torch.tensor(logit).sigmoid().item() for logit in (2.0, 1.0)])


def test_lengths_of_an_untrained_code_stay_finite() -> None:
    found = dense(r1c1=1.0)
    found.boxes[:] = 80.0
    _, boxes = peaks(found, 0.1, 2.0, 1)
    assert boxes[0, 0, 2:4].tolist() == pytest.approx([math.exp(4)] * 2)


def test_four_cells_to_a_pixel_and_few_of_them_hold_a_vehicle() -> None:
    with torch.random.fork_rng():
        torch.manual_seed(0)
        decoder = Decoder(3, width=4, deep=4).eval()
    with torch.no_grad():
        said = decoder(torch.zeros(2, 3, 8, 8))
    assert said.logits.shape == (2, 16, 16) and said.boxes.shape == (2, 6, 16, 16)
    assert said.scores.mean() < 0.05


@pytest.mark.parametrize("size", [1, 2, 3, 64])
def test_the_highest_of_a_neighbourhood_is_what_a_pooling_layer_gives(size: int) -> None:
    x = torch.randn(4, size, size, generator=torch.Generator().manual_seed(size))
    pooled = torch.nn.functional.max_pool2d(x[:, None], kernel_size=3, stride=1, padding=1)[:, 0]
    assert torch.equal(_highest(_highest(x, -1), -2), pooled)


@pytest.mark.parametrize("n", [1, 2, 3, 5, 7])
def test_peaks_have_the_same_bits_in_any_batch(n: int) -> None:
    generator = torch.Generator().manual_seed(n)
    everything = Dense(torch.randn(n, 64, 64, generator=generator) * 3, torch.randn(n, 6, 64, 64, generator=generator))
    scores, boxes = peaks(everything, 0.05, 32.0, 80)
    assert (scores[:, -1] > 0).all()
    for row in range(n):
        alone = peaks(Dense(everything.logits[row : row + 1], everything.boxes[row : row + 1]), 0.05, 32.0, 80)
        assert torch.equal(alone[0][0], scores[row]) and torch.equal(alone[1][0], boxes[row])
