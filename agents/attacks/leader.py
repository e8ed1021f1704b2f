"""Attacks on what the ego follows: the nearest vehicle removed, or a car shown that drives ahead.

Both change little of the view, so that most measures of harm hardly notice them, and nearly all of what the ego's
driving depends on (see `cp_env.metrics`). Removal of one object and spoofing of another are the two classic aims of
attacks on collaborative perception (Zhang et al., "On Data Fabrication in Collaborative Vehicular Perception", USENIX
Security 2024); to aim at the ego's lane is our choice.

The attackers know where the ego stands, as it tells all who send to it. Its heading they take from its motion. Before
it has moved they know the axis of its body alone, from its box in the clean view, where the others see it. Both ends of
the ego are then attacked.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from agents.attacks.gradient import GradientAttack
from agents.attacks.objectives.targeted import Plant, Remove
from agents.attacks.pgd import ProjectedGradient
from agents.protocol import Attack, Streams
from cp_env.geometry.planar import grid_origin
from cp_env.metrics.corridor import Corridor
from cp_env.world.situation import Situation

REACH = 30.0
"""Length of the straight corridor in which the nearest vehicle is looked for; m."""

FRONT = 2.25
"""From the centre of a car to its bumper; m."""

WIDTH = 1.9
"""Of the phantom; m."""

FARTHEST = 25.0
"""Largest gap to a phantom, m: with two half cars and the rounding of grid frames it ends within the map."""

MOVED = 0.3
"""A smaller motion than this between two frames tells no heading; m."""

OWN = 1.5
"""The ego's own box has its centre so near to where it stands; m."""


@dataclass(eq=False)
class EgoHeadings:
    """Which way each world's ego faces, as its motion shows; NaN until it has moved."""

    angle: Float[np.ndarray, " E"] = field(default_factory=lambda: np.zeros(0))  # rad
    _place: Float[np.ndarray, "E 2"] = field(default_factory=lambda: np.zeros((0, 2)))  # of the frame before; m

    def update(self, situation: Situation) -> None:
        """Follow the egos to this frame. A world in its first frame begins anew."""
        place = np.array(situation.place, dtype=np.float64)
        if len(self.angle) != len(place):
            self.angle, self._place = np.full(len(place), np.nan), place
        new = situation.frame == 0
        self.angle[new], self._place[new] = np.nan, place[new]
        step = place - self._place
        moved = np.linalg.norm(step, axis=1) > MOVED
        self.angle[moved] = np.arctan2(step[moved, 1], step[moved, 0])
        self._place = np.where((moved | new)[:, None], place, self._place)


@dataclass(eq=False)
class _Lane:
    """The ego's straight lane, from where it stands in its grid frame, in the clean view of each world."""

    headings: EgoHeadings

    def nearest(self, situation: Situation) -> Float[Tensor, "E 2 5"]:
        """The box of the nearest vehicle in the lane, or of the nearest at all if it is empty; NaN if none is seen.

        While the ego's heading is not known, so is the nearest behind it.
        """
        made = np.full((len(situation.place), 2, 5), np.nan, dtype=np.float32)
        for e, (place, boxes, angles) in enumerate(self._seen(situation)):
            if not len(boxes):
                continue
            at_all = int(np.linalg.norm(boxes[:, :2] - place, axis=1).argmin())
            gaps = [self._corridor(place, angle).gaps(boxes)[0] for angle in angles]
            rows = [int(gap.argmin()) for gap in gaps if np.isfinite(gap).any()]
            chosen = list(dict.fromkeys(rows or [at_all]))
            made[e, : len(chosen)] = boxes[chosen]
        return torch.from_numpy(made).to(situation.coverage)

    def ahead(self, situation: Situation, gap: float) -> Float[Tensor, "E 2 5"]:
        """A car that many metres before the ego's bumper, that heads as the ego does.

        While the heading is not known there is one at either end of the ego; NaN if not even the axis is known.
        """
        made = np.full((len(situation.place), 2, 5), np.nan, dtype=np.float32)
        for e, (place, _, angles) in enumerate(self._seen(situation)):
            for p, angle in enumerate(angles):
                way = (FRONT + gap + FRONT) * np.array([np.cos(angle), np.sin(angle)])
                made[e, p] = [*(place + way), 2 * FRONT, WIDTH, angle]
        return torch.from_numpy(made).to(situation.coverage)

    def _seen(
        self, situation: Situation
    ) -> list[tuple[Float[np.ndarray, " 2"], Float[np.ndarray, "_ 5"], list[float]]]:
        """Where each ego stands, the boxes that it acts on without an attack, and the directions it may face."""
        detector, egos = situation.detector, situation.place - grid_origin(situation.place)
        found = situation.ego_detector().detect(situation.clean, np.full_like(egos, np.inf))
        seen = []
        for place, detections, angle in zip(egos, found, self.headings.angle, strict=True):
            boxes = detections.above(detector.threshold).boxes.astype(np.float64)
            own = np.linalg.norm(boxes[:, :2] - place, axis=1) <= OWN
            axes = boxes[own, 4].tolist()[:1]
            angles = (
                [float(angle)] if np.isfinite(angle) else [turned for axis in axes for turned in (axis, axis + np.pi)]
            )
            seen.append((place, boxes[~own], angles))
        return seen

    def _corridor(self, place: Float[np.ndarray, " 2"], angle: float) -> Corridor:
        end = place + REACH * np.array([np.cos(angle), np.sin(angle)])
        return Corridor(np.stack([place, end]).astype(np.float64), FRONT)


@dataclass
class LeaderAttack:
    """A gradient attack whose place follows the ego: what it needs of every frame, attacked or not, it reads here."""

    attack: GradientAttack
    headings: EgoHeadings

    def reset(self, n_worlds: int, rng: Streams) -> None:
        self.headings.angle = np.zeros(0)
        self.attack.reset(n_worlds, rng)

    def act(self, situation: Situation) -> Float[Tensor, "E k C H W"]:
        """See `Attack.act`."""
        self.headings.update(situation)
        return self.attack.act(situation)


def nearest_removal(
    keep: float = 0.5,
    steps: int = 15,
    step_size: float = 0.1,
    random_start: bool = True,
    restarts: int = 1,
    target_groups: str = "everyone",
    joint: bool = True,
) -> Attack:
    """Hide the vehicle nearest to the ego in its lane, or the nearest at all where the lane is empty.

    The lane is straight: where the ego will turn, the attackers do not know.

    Threat model: white-box on the detector. Of the defence the attackers know that it compares views: `keep` leaves all
    else as it was. With `target_groups="fused"` they pause once they are excluded.

    Args:
        keep: price of what changes elsewhere in the view, see `objectives.targeted.Remove`.
        steps: of the ascent.
        step_size: length of a step in the ball's norm.
        random_start: start from a random point of the ball, or from zero.
        restarts: number of starts.
        target_groups: the groups whose views are attacked, see `GradientAttack`.
        joint: the attackers of a world search together, or each as if the others were benign.

    Returns:
        The attack.

    Raises:
        ValueError: a negative price.
    """
    headings = EgoHeadings()
    objective = Remove(_Lane(headings).nearest, keep=_price(keep))
    search = GradientAttack(
        ProjectedGradient(steps, step_size),
        random_start=random_start,
        restarts=restarts,
        objective=objective,
        target_groups=target_groups,
        joint=joint,
    )
    return LeaderAttack(search, headings)


def phantom_ahead(
    gap: float = 6.0,
    keep: float = 0.5,
    steps: int = 15,
    step_size: float = 0.1,
    random_start: bool = True,
    restarts: int = 1,
    target_groups: str = "everyone",
    joint: bool = True,
) -> Attack:
    """Show a car that drives ahead of the ego, always at the same distance.

    Threat model: as `nearest_removal`. A ghost that keeps its distance resembles itself from frame to frame.

    Args:
        gap: from the ego's bumper to the phantom's; m, up to 25.
        keep: price of what changes elsewhere in the view, see `objectives.targeted.Plant`.
        steps: of the ascent.
        step_size: length of a step in the ball's norm.
        random_start: start from a random point of the ball, or from zero.
        restarts: number of starts.
        target_groups: the groups whose views are attacked, see `GradientAttack`.
        joint: the attackers of a world search together, or each as if the others were benign.

    Returns:
        The attack.

    Raises:
        ValueError: a gap out of range or a negative price.
    """
    if not 0 < gap <= FARTHEST:
        raise ValueError(f"gap must be more than 0 and at most {FARTHEST:g} m, so that the ego can see it; got {gap}")
    headings = EgoHeadings()
    lane = _Lane(headings)
    search = GradientAttack(
        ProjectedGradient(steps, step_size),
        random_start=random_start,
        restarts=restarts,
        objective=Plant(lambda situation: lane.ahead(situation, gap), keep=_price(keep)),
        target_groups=target_groups,
        joint=joint,
    )
    return LeaderAttack(search, headings)


def _price(keep: float) -> float:
    if not keep >= 0:
        raise ValueError(f"keep is a price on changes elsewhere and must be at least 0, not {keep}")
    return keep
