"""Rewards: small pure objects, shared by all attackers. Each gives one number a world from the frame's outcome."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from cp_env.metrics.average_precision import average_precision
from cp_env.metrics.critical import critical_recall
from cp_env.settings import REWARDS, choose
from cp_env.world.situation import Outcome

Reward = Callable[[Outcome], Float[np.ndarray, " E"]]


def damage(outcome: Outcome) -> Float[np.ndarray, " E"]:
    """Detection loss of the frame: 1 - Jaccard of the output and the unattacked view, in [0, 1]."""
    return outcome.damage


def ap_drop(outcome: Outcome) -> Float[np.ndarray, " E"]:
    """AP@0.5 of this frame that the output lost against the clean view, in [-1, 1]; negative where it gained."""
    drops = [
        average_precision([clean.detections], [truth], 0.5) - average_precision([output.detections], [truth], 0.5)
        for clean, output, truth in zip(outcome.clean, outcome.output, outcome.truth, strict=True)
    ]
    return np.array(drops, dtype=np.float32)


def stealth(outcome: Outcome) -> Float[np.ndarray, " E"]:
    """Damage while no alarm is raised: 0 in a frame with a suspect."""
    unflagged = np.array([not verdict.suspects for verdict in outcome.verdicts], dtype=np.float32)
    return outcome.damage * unflagged


def critical(outcome: Outcome) -> Float[np.ndarray, " E"]:
    """Critical recall that the output lost against the clean view, in [-1, 1]; 0 in a frame without a critical vehicle.

    See `cp_env.metrics.critical`.
    """
    lost = []
    for clean, (kept, there), around in zip(outcome.clean, outcome.critical, outcome.surroundings, strict=True):
        found = critical_recall(clean.seen.boxes, around)[0]
        lost.append((found - kept) / max(there, 1))
    return np.array(lost, dtype=np.float32)


def targeted(outcome: Outcome) -> Float[np.ndarray, " E"]:
    """1 in a frame in which the nearest vehicle is removed or a critical ghost spoofed, else 0.

    See `cp_env.metrics.targeted`.
    """
    return (outcome.removed | outcome.spoofed).astype(np.float32)


_REWARDS: dict[str, Reward] = {
    "damage": damage,
    "ap_drop": ap_drop,
    "stealth": stealth,
    "critical": critical,
    "targeted": targeted,
}


def make_reward(reward: str | Reward) -> Reward:
    """The reward called by that name, or a user's own callable as it is."""
    return reward if callable(reward) else _REWARDS[choose("reward", reward, REWARDS)]
