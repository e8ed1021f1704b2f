"""A target scene: the cars that the ego shall see, and no others.

The effect of an untargeted attack on the ego's view changes from frame to frame, and that reveals it. Attackers that
agree on a scene can show the same one again, or change it as slowly as they like.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from agents.attacks.gradient import no_perturbation
from agents.attacks.targets import AttackTargets, ViewLoss
from cp_env.detector.model.decoder import Dense
from cp_env.detector.training.loss import Targets, stack
from cp_env.detector.training.loss import targets as decoder_targets
from cp_env.geometry.planar import grid_origin
from cp_env.perturbation.objective import BLOCK, MARGIN, REACH
from cp_env.world.counterfactual import clean_views, views_under
from cp_env.world.situation import Situation

Boxes = Callable[[Situation], list[Float[np.ndarray, "_ 5"]]]
"""The boxes of each world's scene, in its ego's current grid frame; m and rad."""

GHOST = (4.5, 1.9, 0.0)
"""Length, width and heading of a car that is not there."""

APART = 4.0
"""Least distance between the centres of two cars of a scene, m; closer ones overlap."""


@dataclass(frozen=True, eq=False)
class SceneTarget:
    """Make the ego see the cars of `boxes`, one in each cell that holds a box's centre, and no other.

    In a cell of the scene the logit rises up to `MARGIN`, and the box that it reports goes there (L1, up to `REACH`).
    Elsewhere, except in the neighbours of those cells, detections are suppressed: each block of the size of a car
    counts as its most promising cell does, as in `adversarial_loss`.

    Args:
        boxes: the cars of each world's scene.
    """

    boxes: Boxes

    def __call__(self, targets: AttackTargets) -> ViewLoss:
        drawn = self._decoder_targets(targets)
        device = targets.groups.device
        heat, code, near = (part.to(device)[targets.rows] for part in (drawn.heat, drawn.boxes, drawn.box_weight > 0))
        wanted = heat == 1

        def view_loss(dense: Dense) -> Float[Tensor, " B"]:
            wrong = (dense.boxes - code).abs().clamp(max=REACH).mean(1)
            shown = (wanted * (dense.logits.clamp(max=MARGIN) - wrong)).sum((-2, -1))
            others = dense.logits.masked_fill(near, torch.finfo(dense.logits.dtype).min / 2)
            blocks = functional.unfold(others[:, None], kernel_size=BLOCK, stride=BLOCK).logsumexp(1)
            return shown - functional.softplus(blocks).sum(1)

        return view_loss

    def _decoder_targets(self, targets: AttackTargets) -> Targets:
        """The scenes of all worlds as the decoder's targets."""
        clean, extent = targets.situation.clean, targets.situation.detector.extent
        size, drawn = clean.logits.shape[-1], []
        for boxes in self.boxes(targets.situation):
            inside = torch.from_numpy(boxes[(np.abs(boxes[:, :2]) < extent).all(axis=1)])
            drawn.append(decoder_targets(inside, torch.ones(1, len(inside), dtype=torch.bool), size, extent))
        return stack(drawn)


def last_output(situation: Situation) -> list[Float[np.ndarray, "_ 5"]]:
    """The ego's last output, moved by its own motion: to show it again is to change nothing."""
    views = [view or clean for view, clean in zip(situation.output, clean_views(situation), strict=True)]
    motion = [view.origin - grid_origin(place) for view, place in zip(views, situation.place, strict=True)]
    return [moved(view.seen.boxes, by) for view, by in zip(views, motion, strict=True)]


def ego_view(situation: Situation) -> list[Float[np.ndarray, "_ 5"]]:
    """The ego's own view, if it is benign."""
    pairs = [(e, frozenset({0})) for e in range(len(situation.place))]
    return [view.seen.boxes.astype(np.float32) for view in views_under(situation, no_perturbation(situation), pairs)]


def moved(boxes: Float[np.ndarray, "L 5"], by: Float[np.ndarray, " 2"]) -> Float[np.ndarray, "L 5"]:
    """The boxes moved by that much, m."""
    return (boxes + np.array([*by, 0.0, 0.0, 0.0])).astype(np.float32)


def lattice_ghosts(spacing: float) -> Boxes:
    """Ghost cars on a lattice of `spacing` m that is fixed in the world.

    They stand still whichever ego drives by. So each is seen again where it was, and nothing has to be remembered.

    Args:
        spacing: of the lattice, m.

    Returns:
        The boxes of each world's scene.

    Raises:
        ValueError: a spacing at which ghosts overlap.
    """
    if not spacing >= APART:
        raise ValueError(f"ghosts must stand at least {APART} m apart, or they overlap; got spacing={spacing}")

    def boxes(situation: Situation) -> list[Float[np.ndarray, "_ 5"]]:
        extent, scenes = situation.detector.extent, []
        for origin in grid_origin(situation.place):
            x, y = (np.arange(np.ceil((o - extent) / spacing), (o + extent) / spacing) * spacing - o for o in origin)
            centre = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
            scenes.append(np.hstack([centre, np.tile(GHOST, (len(centre), 1))]).astype(np.float32))
        return scenes

    return boxes


def merged(one: Boxes, other: Boxes) -> Boxes:
    """The cars of the one, and those of the other that do not overlap them."""

    def boxes(situation: Situation) -> list[Float[np.ndarray, "_ 5"]]:
        scenes = []
        for a, b in zip(one(situation), other(situation), strict=True):
            gap = np.linalg.norm(b[:, None, :2] - a[None, :, :2], axis=-1)
            scenes.append(np.concatenate([a, b[(gap > APART).all(axis=1)]]))
        return scenes

    return boxes
