"""Whole episodes of one attacker on given scenes, and what they cost the ego."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Float

from cp_env.evaluation import Attacker, Learned, Protocol, Stage, plan
from cp_env.world.scene_cache import SceneBank


@dataclass(frozen=True, eq=False)
class Episodes:
    """One number an episode."""

    damage: Float[np.ndarray, " n"]  # sum over frames of 1 - Jaccard(output, clean)
    frames: Float[np.ndarray, " n"]
    similarity: Float[np.ndarray, " n"]  # mean over frames, everyone fused against the last output
    verifications: Float[np.ndarray, " n"]  # mean over frames
    excluded: Float[np.ndarray, " n"]  # mean share of the liars that the output left out

    @classmethod
    def joined(cls, parts: Sequence[Episodes]) -> Episodes:
        return cls(*(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(cls)))


def play(
    attacker: Attacker | Learned,
    protocol: Protocol,
    bank: SceneBank,
    *,
    defender: str,
    k: int = 2,
    seed: int = 0,
    batch: int = 6,
) -> Episodes:
    """One episode on each scene of the protocol, `batch` at a time.

    Seed and scene fix where it starts, the liars and the noise, whoever plays. Every batch meets the attacker as it was
    handed over: what it remembers of one is not carried into the next.
    """
    cells = plan(protocol, defenders=(defender,), attacks=("attacker",), ks=(k,), seeds=(seed,), batch=batch)
    return Episodes.joined([_episodes(Stage(cell, protocol, bank, copy.deepcopy(attacker))) for cell in cells])


def _episodes(stage: Stage) -> Episodes:
    worlds = stage.world.num_envs
    totals, over = np.zeros((len(fields(Episodes)), worlds)), np.zeros(worlds, dtype=bool)
    while not over.all():
        outcome = stage.move()
        collaborators = [verdict.collaborators for verdict in outcome.verdicts]
        out = [[v not in kept for v in liars] for liars, kept in zip(outcome.attackers, collaborators, strict=True)]
        frame = [outcome.damage, np.ones(worlds), outcome.similarity, outcome.verifications, np.mean(out, axis=1)]
        totals += np.where(over, 0.0, np.stack(frame))
        over |= outcome.truncated
    damage, frames, *means = totals
    return Episodes(damage, frames, *(total / frames for total in means))
