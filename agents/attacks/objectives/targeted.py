"""Targeted objectives: remove one car, or plant one. Places lie in the ego's grid frame, m.

Our choice, as the paper's attack is untargeted. Both speak of `Dense` alone, whatever detector made it; logits stop
counting `MARGIN` beyond the middle, as in `adversarial_loss`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from agents.attacks.targets import AttackTargets, ViewLoss
from cp_env.detector.model.decoder import Dense, cell_centres
from cp_env.perturbation.objective import MARGIN, REACH
from cp_env.world.situation import Situation

Numbers = Sequence[float] | Sequence[Sequence[float]] | np.ndarray | Tensor
Place = Callable[[Situation], Float[Tensor, "E n"] | Float[Tensor, "E P n"]]
"""Where, in each world, one place or P: (x, y) or a whole box (x, y, length, width, yaw); m, rad; NaN is nothing."""

TARGET = 2.5
"""Radius around a car's centre, m, in which no cell may report a car if it is to be gone."""

APART = 6.0
"""Distance from the target, m, from which cells count as elsewhere."""


@dataclass(frozen=True, eq=False)
class Remove:
    """Conceal the car at `at`: minus the log-sum-exp of the logits around it, since one cell is enough to report it.

    Args:
        at: the place of the car, or of several: their values are added.
        keep: weight of the change elsewhere, Σ (p' − p)² over the other cells. 0 ignores it; a larger weight leaves the
            rest of the view, and so its similarity to the last output, as it was.
    """

    at: Place
    keep: float = 0.0

    def __call__(self, targets: AttackTargets) -> ViewLoss:
        near = _distance(targets, _places(targets, self.at)) <= TARGET  # NaN is near to nothing
        there, change = near.any(-1).any(-1), _elsewhere(targets, self.at, self.keep)

        def view_loss(dense: Dense) -> Float[Tensor, " B"]:
            lowest = torch.finfo(dense.logits.dtype).min / 2
            left = dense.logits[:, None].masked_fill(~near, lowest).flatten(2).logsumexp(2)
            return torch.where(there, (-left).clamp(max=MARGIN), 0.0).sum(1) - change(dense)

        return view_loss


@dataclass(frozen=True, eq=False)
class Plant:
    """Make the ego see a car in the box `at`.

    The logit of the cell that holds its centre rises, and the box that this cell reports goes there (L1 of the
    regression, up to `REACH`).

    Args:
        at: the box of the car, or of several: their values are added.
        keep: as for `Remove`.
    """

    at: Place
    keep: float = 0.0

    def __call__(self, targets: AttackTargets) -> ViewLoss:
        box = _places(targets, self.at)
        there = torch.isfinite(box).all(-1)
        rows, (row, column) = torch.arange(len(box), device=box.device)[:, None], _cell(targets, box, there)
        code, change = _code(targets, box, row, column), _elsewhere(targets, self.at, self.keep)
        code = torch.where(there[..., None], code, 0.0)

        def view_loss(dense: Dense) -> Float[Tensor, " B"]:
            logit, said = dense.logits[rows, row, column], dense.boxes[rows, :, row, column]
            shown = logit.clamp(max=MARGIN) - (said - code).abs().clamp(max=REACH).mean(-1)
            return torch.where(there, shown, 0.0).sum(1) - change(dense)

        return view_loss


def remove(*numbers: float) -> Remove:
    """The clean view's detection of that number, 0 the one of highest score (the default), or the car at (x, y)."""
    if len(numbers) > 2:
        raise TypeError(f"remove takes a detection's number or x and y, got {numbers}")
    return Remove(spot(numbers) if len(numbers) == 2 else detection(int(numbers[0]) if numbers else 0))


def plant(x: float = 10.0, y: float = 0.0, yaw: float = 0.0, length: float = 4.5, width: float = 1.9) -> Plant:
    """A car of that place, heading and size."""
    return Plant(spot((x, y, length, width, yaw)))


def spot(numbers: Numbers) -> Place:
    """A fixed place: the same in all worlds, or a row for each."""
    fixed = torch.as_tensor(numbers, dtype=torch.float32)
    return lambda situation: fixed.to(situation.coverage).expand(len(situation.fused), -1)


def detection(index: int | Sequence[int]) -> Place:
    """The box of the clean view's detection of that number, best first: one number for all worlds, or one for each."""

    def place(situation: Situation) -> Float[Tensor, "E 5"]:
        found = situation.ego_detector().detect(situation.clean)
        boxes = np.full((len(found), 5), np.nan, dtype=np.float32)
        for e, (number, seen) in enumerate(zip(np.broadcast_to(index, len(found)), found, strict=True)):
            if 0 <= number < len(seen.boxes):
                boxes[e] = seen.boxes[number]
        return torch.from_numpy(boxes).to(situation.coverage)

    return place


def _places(targets: AttackTargets, at: Place) -> Float[Tensor, "B P n"]:
    """The places of each view's world."""
    place = at(targets.situation)[targets.rows]
    return place[:, None] if place.dim() == 2 else place


def _distance(targets: AttackTargets, place: Float[Tensor, "B P n"]) -> Float[Tensor, "B P h w"]:
    """The distance of each cell's centre to the places, m."""
    centre = cell_centres(targets.clean.logits.shape[-1], targets.situation.detector.extent, place)
    return torch.hypot(centre - place[..., 0, None, None], centre[:, None] - place[..., 1, None, None])


def _elsewhere(targets: AttackTargets, at: Place, keep: float) -> ViewLoss:
    """`keep` times the change of the probabilities away from all places; nothing where there is no place."""
    if keep == 0:
        return lambda dense: dense.logits.new_zeros(len(dense.logits))
    place = _places(targets, at)
    some = torch.isfinite(place[..., :2]).all(-1).any(-1)[:, None, None]
    far = (~(_distance(targets, place) <= APART).any(1) & some).float()
    before = targets.clean.scores
    return lambda dense: keep * (far * (dense.scores - before).square()).sum((-2, -1))


def _cell(targets: AttackTargets, box: Float[Tensor, "B P 5"], there: Bool[Tensor, "B P"]) -> tuple[Tensor, Tensor]:
    """Row and column of the cell that holds each centre; 0 where there is no box."""
    size, extent = targets.clean.logits.shape[-1], targets.situation.detector.extent
    if not bool((box[there][:, :2].abs() < extent).all()):
        raise ValueError(f"a car is planted within {extent} m of the ego's grid centre, not at {box[..., :2].tolist()}")
    cells = (torch.where(there[..., None], box[..., :2], 0.0) + extent) * (size / (2 * extent))
    column, row = cells.long().clamp(max=size - 1).unbind(-1)
    return row, column


def _code(targets: AttackTargets, box: Float[Tensor, "B P 5"], row: Tensor, column: Tensor) -> Float[Tensor, "B P 6"]:
    """The code of each box in that cell, as the decoder would give it: see `Dense`."""
    centre = cell_centres(targets.clean.logits.shape[-1], targets.situation.detector.extent, box)
    x, y, length, width, yaw = box.unbind(-1)
    parts = [x - centre[column], y - centre[row], length.log(), width.log(), (2 * yaw).sin(), (2 * yaw).cos()]
    return torch.stack(parts, -1)
