"""Attacks on what the ego follows: vehicles ahead removed, or a car shown that drives there.

They change nearly all of what the ego's driving depends on (see `cp_env.metrics`). Those with one target change little
else, so that most measures of harm hardly notice them. Removal of one object and spoofing of another are the two
classic aims of attacks on collaborative perception (Zhang et al., "On Data Fabrication in Collaborative Vehicular
Perception", USENIX Security 2024); to aim at the ego's lane is our choice.

The attackers know where the ego stands and which way it faces, as it tells all who send to it. Where it will turn they
do not know: its lane is straight.
"""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from agents.attacks.gradient import GradientAttack
from agents.attacks.objectives.targeted import Plant, Remove
from agents.attacks.pgd import ProjectedGradient
from agents.attacks.random_action import RandomActions
from agents.protocol import Attack
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

OWN = 1.5
"""The ego's own box has its centre so near to where it stands; m."""


def nearest_in_lane(situation: Situation) -> Float[Tensor, "E 1 5"]:
    """The box of the nearest vehicle in each ego's straight lane, or of the nearest at all where the lane is empty.

    What the ego acts on without an attack says who is there; NaN if nobody is seen.
    """
    made = np.full((len(situation.place), 1, 5), np.nan, dtype=np.float32)
    for e, (place, heading, boxes) in enumerate(zip(*_egos(situation), _seen(situation), strict=True)):
        if not len(boxes):
            continue
        lane = np.stack([place, place + REACH * _unit(heading)])
        gaps, _ = Corridor(lane, FRONT).gaps(boxes)
        away = np.linalg.norm(boxes[:, :2] - place, axis=1)
        made[e] = boxes[gaps.argmin() if np.isfinite(gaps).any() else away.argmin()]
    return torch.from_numpy(made).to(situation.coverage)


def car_ahead(situation: Situation, gap: float) -> Float[Tensor, "E 1 5"]:
    """A car that many metres before each ego's bumper, that heads as the ego does."""
    egos, away = zip(*_egos(situation), strict=True), FRONT + gap + FRONT
    made = [[*(place + away * _unit(heading)), 2 * FRONT, WIDTH, heading] for place, heading in egos]
    return torch.tensor(made, dtype=torch.float32)[:, None].to(situation.coverage)


def _egos(situation: Situation) -> tuple[Float[np.ndarray, "E 2"], Float[np.ndarray, " E"]]:
    """Where each ego stands in its grid frame, and which way it faces."""
    return situation.place - grid_origin(situation.place), situation.heading


def _unit(heading: float) -> Float[np.ndarray, " 2"]:
    return np.array([np.cos(heading), np.sin(heading)])


def _seen(situation: Situation) -> list[Float[np.ndarray, "_ 5"]]:
    """The boxes that each ego acts on without an attack, its own left out."""
    places, _ = _egos(situation)
    found = situation.ego_detector().detect(situation.clean, np.full_like(places, np.inf))
    seen = []
    for place, detections in zip(places, found, strict=True):
        boxes = detections.above(situation.detector.threshold).boxes.astype(np.float64)
        seen.append(boxes[np.linalg.norm(boxes[:, :2] - place, axis=1) > OWN])
    return seen


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
    return GradientAttack(
        ProjectedGradient(steps, step_size),
        random_start=random_start,
        restarts=restarts,
        objective=Remove(nearest_in_lane, keep=_price(keep)),
        target_groups=target_groups,
        joint=joint,
    )


def critical_removal() -> Attack:
    """Hide all that is ahead of the ego, and hold back while the view would be too unlike the last output.

    The middle of the action map `critical`: what a policy does there before it learns. No single vehicle is aimed at,
    so it hides what crosses the ego's way as well as what it follows, and disturbs more of the view than
    `nearest_removal`.

    Threat model: white-box on the detector. Of the defence the attackers know that it compares views with the last
    output, and whom it is expected to fuse; half of what was seen is kept.

    Returns:
        The attack.
    """
    return RandomActions("critical", reach=0.0)


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
    return GradientAttack(
        ProjectedGradient(steps, step_size),
        random_start=random_start,
        restarts=restarts,
        objective=Plant(lambda situation: car_ahead(situation, gap), keep=_price(keep)),
        target_groups=target_groups,
        joint=joint,
    )


def _price(keep: float) -> float:
    if not keep >= 0:
        raise ValueError(f"keep is a price on changes elsewhere and must be at least 0, not {keep}")
    return keep
