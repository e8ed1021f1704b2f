"""Counterfactual views: what the ego would see under a perturbation, as the world computes it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from weakref import WeakKeyDictionary

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from cp_env.detector.model.base import BaseDetector
from cp_env.detector.protocol import DetectorLike
from cp_env.metrics import similarity
from cp_env.perturbation import channel
from cp_env.types import View
from cp_env.world.episode import make_views
from cp_env.world.situation import Situation

Group = frozenset[int]
Pair = tuple[int, Group]


def in_precision(situation: Situation, precision: str) -> Situation:
    """The same situation under the detector in another precision, for a search that need not be exact.

    Raises:
        ValueError: the detector does not know that precision.
    """
    detector = rounded(situation.detector, precision)
    receive = cache(lambda: situation.received.to(getattr(torch, precision)))
    return replace(situation, detector=detector, receive=receive)


def rounded(detector: DetectorLike, precision: str) -> DetectorLike:
    """The detector in another precision; made once.

    Raises:
        ValueError: the detector does not know that precision.
    """
    if not isinstance(detector, BaseDetector):
        raise ValueError(f"detector {type(detector).__name__} knows no precision but its own, not {precision!r}")
    other = _COPIES.setdefault(detector, {})
    if precision not in other:
        other[precision] = detector.with_precision(precision)
    twin: DetectorLike = other[precision]  # type: ignore[assignment]  # as whole as the detector itself
    return twin


_COPIES: WeakKeyDictionary[BaseDetector, dict[str, BaseDetector]] = WeakKeyDictionary()
"""Of each detector those in another precision: a copy a frame would take longer than it saves."""


@torch.no_grad()
def views_under(situation: Situation, delta: Float[Tensor, "E k C H W"], pairs: Sequence[Pair]) -> list[View]:
    """The view of each (world, group) if δ were sent now.

    Args:
        situation: the current frame.
        delta: one perturbation for each attacker, in its own grid frame.
        pairs: which group of which world each view fuses.

    Returns:
        One view a pair.
    """
    pose = torch.take_along_dim(situation.ego_T_sender, situation.attackers[..., None], 1)
    warped = situation.detector.warp(delta, pose)
    attacked = channel.inject(situation.received, warped, situation.attackers)
    groups = torch.zeros(len(pairs), situation.fused.shape[1], dtype=torch.bool)
    for row, (_, group) in zip(groups, pairs, strict=True):
        row[sorted(group)] = True
    worlds, device = [e for e, _ in pairs], situation.device
    world = torch.tensor(worlds, dtype=torch.long, device=device)
    dense = situation.ego_detector().perceive(attacked, situation.coverage, world, groups.to(device))
    frames, places = situation.frame[worlds].tolist(), list(situation.place[worlds])
    return make_views(situation.detector, dense, [group for _, group in pairs], frames, places)


def clean_views(situation: Situation) -> list[View]:
    """The view that each ego would have of everyone without an attack."""
    everyone = frozenset(range(situation.fused.shape[1]))
    frames, places = situation.frame.tolist(), list(situation.place)
    return make_views(situation.detector, situation.clean, [everyone] * len(places), frames, places)


def similarities(views: Sequence[View], references: Sequence[View | None]) -> Float[np.ndarray, " V"]:
    """Similarity of each view to its reference, Eq. (5); 1 where there is none yet."""
    pairs = [(v, v if reference is None else reference) for v, reference in zip(views, references, strict=True)]
    return similarity.view_similarity_many(pairs)


def damage(views: Sequence[View], clean: Sequence[View]) -> Float[np.ndarray, " V"]:
    """Detection loss (1 - Jaccard) of each view against the unattacked one."""
    return 1 - similarity.jaccard_many([v.seen.boxes for v in views], [c.seen.boxes for c in clean])
