"""A lie as a picture: which cars the ego shall see, and none besides.

What an untargeted attack makes of the ego's view changes from frame to frame, and that is what gives it away. Liars who
agree on a picture can show the same one again, or change it as slowly as they like.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from agents.attacks.gradient import silence
from agents.attacks.targets import Score, Views
from cp_env.detector.model.decoder import Dense
from cp_env.detector.training.loss import Targets, stack, targets
from cp_env.geometry.planar import grid_origin
from cp_env.perturbation.objective import BLOCK, MARGIN, REACH
from cp_env.world.counterfactual import foresee, honest
from cp_env.world.situation import Situation

Boxes = Callable[[Situation], list[Float[np.ndarray, "_ 5"]]]
"""The boxes of each world's picture, in its ego's grid frame of now; m and rad."""

GHOST = (4.5, 1.9, 0.0)
"""Length, width and heading of a car that is not there."""

APART = 4.0
"""Between the centres of two cars of a picture, m: no less than that, or they overlap."""


@dataclass(frozen=True, eq=False)
class Picture:
    """Make the ego see the cars of `boxes`, one in each cell that holds a box's centre, and no other.

    In a cell of the picture the logit rises up to `MARGIN`, and what it says of its box goes there (L1, up to `REACH`).
    Elsewhere, but for the neighbours of those cells, what could be seen is pushed down: each block of the size of a car
    counts as its most promising cell does, as in `adversarial_loss`.
    """

    boxes: Boxes

    def __call__(self, views: Views) -> Score:
        drawn = self._drawn(views)
        device = views.groups.device
        heat, code, near = (part.to(device)[views.rows] for part in (drawn.heat, drawn.boxes, drawn.box_weight > 0))
        wanted = heat == 1

        def score(dense: Dense) -> Float[Tensor, " B"]:
            wrong = (dense.boxes - code).abs().clamp(max=REACH).mean(1)
            shown = (wanted * (dense.logits.clamp(max=MARGIN) - wrong)).sum((-2, -1))
            others = dense.logits.masked_fill(near, torch.finfo(dense.logits.dtype).min / 2)
            blocks = functional.unfold(others[:, None], kernel_size=BLOCK, stride=BLOCK).logsumexp(1)
            return shown - functional.softplus(blocks).sum(1)

        return score

    def _drawn(self, views: Views) -> Targets:
        """The pictures of all worlds as the decoder's targets."""
        clean, extent = views.situation.clean, views.situation.detector.extent
        size, drawn = clean.logits.shape[-1], []
        for boxes in self.boxes(views.situation):
            inside = torch.from_numpy(boxes[(np.abs(boxes[:, :2]) < extent).all(axis=1)])
            drawn.append(targets(inside, torch.ones(1, len(inside), dtype=torch.bool), size, extent))
        return stack(drawn)


def remembered(situation: Situation) -> list[Float[np.ndarray, "_ 5"]]:
    """What the ego acted on last, moved by its own motion: to show it again is to change nothing."""
    views = [view or clean for view, clean in zip(situation.output, honest(situation), strict=True)]
    motion = [view.origin - grid_origin(place) for view, place in zip(views, situation.place, strict=True)]
    return [moved(view.seen.boxes, by) for view, by in zip(views, motion, strict=True)]


def alone(situation: Situation) -> list[Float[np.ndarray, "_ 5"]]:
    """What the ego sees by itself, if it does not lie."""
    pairs = [(e, frozenset({0})) for e in range(len(situation.place))]
    return [view.seen.boxes.astype(np.float32) for view in foresee(situation, silence(situation), pairs)]


def moved(boxes: Float[np.ndarray, "L 5"], by: Float[np.ndarray, " 2"]) -> Float[np.ndarray, "L 5"]:
    """The boxes that much further on, m."""
    return (boxes + np.array([*by, 0.0, 0.0, 0.0])).astype(np.float32)


def crossings(spacing: float) -> Boxes:
    """Cars that are not there, on the crossings of a lattice of `spacing` m that is fixed in the world.

    They stand still, whoever drives by, so that each is seen again where it was; and no one need remember them.
    """
    if not spacing >= APART:
        raise ValueError(f"ghosts must stand at least {APART} m apart, or they overlap; got spacing={spacing}")

    def boxes(situation: Situation) -> list[Float[np.ndarray, "_ 5"]]:
        extent, pictures = situation.detector.extent, []
        for origin in grid_origin(situation.place):
            x, y = (np.arange(np.ceil((o - extent) / spacing), (o + extent) / spacing) * spacing - o for o in origin)
            centre = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
            pictures.append(np.hstack([centre, np.tile(GHOST, (len(centre), 1))]).astype(np.float32))
        return pictures

    return boxes


def both(one: Boxes, other: Boxes) -> Boxes:
    """The cars of the one, and those of the other that do not stand in their way."""

    def boxes(situation: Situation) -> list[Float[np.ndarray, "_ 5"]]:
        pictures = []
        for a, b in zip(one(situation), other(situation), strict=True):
            gap = np.linalg.norm(b[:, None, :2] - a[None, :, :2], axis=-1)
            pictures.append(np.concatenate([a, b[(gap > APART).all(axis=1)]]))
        return pictures

    return boxes
