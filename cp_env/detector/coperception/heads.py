"""coperception's two heads on its decoder's output, and the way from six anchors a cell of 0.25 m to boxes.

Convention: a cell's anchors are (width, length, angle); maps here keep coperception's layout, in which columns fall
with x. Its frame is ours mirrored, u = -x, v = y, and its angles turn clockwise there: in ours they turn
counter-clockwise, from a heading along y. A code is (x, y, w, l, sin, cos): the centre's offset from the anchor's in
sizes of the box, negated; the logarithm of anchor size over box size; the angle from the anchor's. Nothing makes sin
and cos a unit vector: its length scales the box, as there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn
from torch.nn import functional

from cp_env.detector.coperception.checkpoint import Weights, layer
from cp_env.detector.coperception.grid import CELL, EXTENT, SIZE
from cp_env.detector.model.decoder import Dense

ANGLES = (0.0, math.pi / 2, -math.pi / 4)
ANCHORS = tuple((*size, angle) for size in ((2.0, 4.0), (3.0, 12.0)) for angle in ANGLES)
CODE = 6
MAP_SIZE = 64
"""Cells of 1 m along a side of the `Dense` map."""

BLOCK = SIZE // MAP_SIZE
LARGEST = 4.0
"""Log size (m) at which boxes stop growing: random weights must not overflow."""


@dataclass(frozen=True, eq=False)
class Anchored(Dense):
    """Every cell of 1 m says what the best of its 96 anchors does; and the K best anchors of the view, for boxes.

    `scores_found` are 0 where fewer than K anchors reach the floor.
    """

    scores_found: Float[Tensor, "B K"]
    boxes_found: Float[Tensor, "B K 5"]


class Heads(nn.Module):
    """The heads' first convolutions side by side in one, and so their second; of two classes only the difference."""

    def __init__(self, weights: Weights) -> None:
        super().__init__()
        box, shape = "regression.box_prediction", (32, 32, 3, 3)
        first, first_bias = weights.conv("classification.conv1", "classification.bn1", shape)
        second, second_bias = weights.conv(f"{box}.0", f"{box}.1", shape)
        self.first = layer(torch.cat([first, second]), torch.cat([first_bias, second_bias]))
        weight, bias = weights.conv("classification.conv2", None, (2 * len(ANCHORS), 32, 1, 1))
        self.score = layer(weight[1::2] - weight[::2], bias[1::2] - bias[::2])
        self.code = layer(*weights.conv(f"{box}.3", None, (CODE * len(ANCHORS), 32, 1, 1)))

    def forward(
        self, x: Float[Tensor, "B 32 256 256"]
    ) -> tuple[Float[Tensor, "B 6 256 256"], Float[Tensor, "B 6 6 256 256"]]:
        """Log-odds of each anchor, and its code [B, anchor, number, row, column]; coperception's layout."""
        for_scores, for_codes = functional.relu(self.first(x)).chunk(2, dim=1)
        return self.score(for_scores), self.code(for_codes).unflatten(1, (len(ANCHORS), CODE))


def boxes_of(
    codes: Float[Tensor, "B K 6"], index: Int[Tensor, "B K"]
) -> tuple[Float[Tensor, "B K 2"], Float[Tensor, "B K 2"], Float[Tensor, "B K 2"]]:
    """Centre, (log length, log width) and (sin 2yaw, cos 2yaw), our frame, of anchors (a · S + row) · S + column."""
    table = codes.new_tensor(ANCHORS)[torch.div(index, SIZE * SIZE, rounding_mode="floor")]
    row, column = torch.div(index, SIZE, rounding_mode="floor") % SIZE, index % SIZE
    width, length = (table[..., i].log() - codes[..., 2 + i] for i in (0, 1))
    width, length = width.clamp(max=LARGEST), length.clamp(max=LARGEST)
    x = codes[..., 0] * width.exp() - ((column + 0.5) * CELL - EXTENT)
    y = ((row + 0.5) * CELL - EXTENT) - codes[..., 1] * length.exp()
    sin, cos = table[..., 2].sin(), table[..., 2].cos()
    sin, cos = sin * codes[..., 5] + cos * codes[..., 4], cos * codes[..., 5] - sin * codes[..., 4]
    # the heading is the angle from the y axis on: sin and cos of twice it turn round, and unit length is not given
    double = torch.stack([-2 * sin * cos, sin * sin - cos * cos], dim=-1)
    square = double.norm(dim=-1, keepdim=True).clamp(min=1e-12)
    scaled = torch.stack([length, width], dim=-1) + square.log() / 2
    return torch.stack([x, y], dim=-1), scaled, double / square


def reduce(
    logits: Float[Tensor, "B 6 256 256"], codes: Float[Tensor, "B 6 6 256 256"]
) -> tuple[Float[Tensor, "B 64 64"], Float[Tensor, "B 6 64 64"]]:
    """`Dense`'s two maps: of each cell of 1 m the best anchor, its box relative to the cell's centre; our layout."""
    tiles = functional.pixel_unshuffle(logits, BLOCK)  # B, anchor · 16 + cell of the block, 64, 64
    best, place = tiles.max(dim=1)
    rows = torch.arange(MAP_SIZE, device=logits.device)
    row = BLOCK * rows[:, None] + torch.div(place % BLOCK**2, BLOCK, rounding_mode="floor")
    column = BLOCK * rows[None, :] + place % BLOCK
    index = ((torch.div(place, BLOCK**2, rounding_mode="floor") * SIZE + row) * SIZE + column).flatten(1)
    centre, size, double = boxes_of(pick(codes, index), index)
    middle = (rows + 0.5) * (2 * EXTENT / MAP_SIZE) - EXTENT
    cell = torch.stack([-middle.repeat(MAP_SIZE), middle.repeat_interleave(MAP_SIZE)], dim=-1)  # columns fall with x
    boxes = torch.cat([centre - cell, size, double], dim=-1)
    return best.flip(-1), boxes.transpose(1, 2).unflatten(2, (MAP_SIZE, MAP_SIZE)).flip(-1)


def best_anchors(
    logits: Float[Tensor, "B 6 256 256"], codes: Float[Tensor, "B 6 6 256 256"], floor: float, most: int
) -> tuple[Float[Tensor, "B K"], Float[Tensor, "B K 5"]]:
    """Scores and boxes (our frame) of the best `most` anchors of a view, best first; scores below the floor are 0."""
    score, index = logits.detach().flatten(1).topk(most, dim=1)
    centre, size, double = boxes_of(pick(codes.detach(), index), index)
    yaw = torch.atan2(double[..., :1], double[..., 1:]) / 2
    score = score.sigmoid()
    return score * (score >= floor), torch.cat([centre, size.exp(), yaw], dim=-1)


def pick(codes: Float[Tensor, "B 6 6 256 256"], index: Int[Tensor, "B K"]) -> Float[Tensor, "B K 6"]:
    """The codes of anchors by their number."""
    anchor, place = torch.div(index, SIZE * SIZE, rounding_mode="floor"), index % (SIZE * SIZE)
    number = torch.arange(CODE, device=index.device)
    flat = (anchor[..., None] * CODE + number) * SIZE * SIZE + place[..., None]
    return codes.flatten(1).gather(1, flat.flatten(1)).unflatten(1, (-1, CODE))
