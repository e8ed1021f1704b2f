"""Whole episodes of one attack on given scenes, and what they cost the ego."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import lru_cache

import numpy as np
from jaxtyping import Float

from cp_env.detector.registry import open_detector
from cp_env.envs.reward import critical
from cp_env.evaluation import Attack, Conditions, Learned, Rollout, plan_runs
from cp_env.evaluation.plan.runs import file_words
from cp_env.scenes.subset import SceneSubset
from cp_env.settings import Fusion
from cp_env.world.scene_cache import SceneBank
from defenders.registry import Spec


@dataclass(frozen=True, eq=False)
class Episodes:
    """One number an episode."""

    damage: Float[np.ndarray, " n"]  # 1 - Jaccard(output, clean), mean over frames
    frames: Float[np.ndarray, " n"]
    similarity: Float[np.ndarray, " n"]  # mean over frames, everyone fused against the last output
    verifications: Float[np.ndarray, " n"]  # mean over frames
    excluded: Float[np.ndarray, " n"]  # mean share of the attackers that the output left out
    critical: Float[np.ndarray, " n"]  # critical recall that the output lost, mean over frames: the reward `critical`

    @classmethod
    def joined(cls, parts: Sequence[Episodes]) -> Episodes:
        return cls(*(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(cls)))


@lru_cache(maxsize=4)
def open_bank(scenes: str, n_scenes: int, detector: str = "cp_env", fusion: Fusion = "mean") -> SceneBank:
    """A bank of `n_scenes` of the scenes called so, under the detector called so; the same one if asked again.

    Raises:
        ValueError: unknown scenes or an unknown detector, or more scenes than there are.
    """
    return SceneBank(SceneSubset(scenes, n_scenes), open_detector(detector, fusion=fusion))


def slug(defender: str) -> str:
    """A name fit for files: `pasac:score=similarity` is `pasac-similarity`."""
    spec = Spec.parse(defender)
    return file_words("-".join([spec.name, *spec.options.values()]))


def play(
    attack: Attack | Learned,
    conditions: Conditions,
    bank: SceneBank,
    *,
    defender: str,
    k: int = 2,
    seed: int = 0,
    batch: int = 6,
) -> Episodes:
    """One episode on each scene of the conditions, `batch` at a time.

    Seed and scene decide the start, the attackers and the noise, whatever attack plays. Every batch meets the attack as
    it was given: what it remembers of one batch is not carried into the next.

    Args:
        attack: scripted or learned.
        conditions: scenes, frames and the settings of the environment.
        bank: the encoded scenes.
        defender: name, with options if need be.
        k: number of attackers.
        seed: of starts, attackers and noise.
        batch: scenes in lock-step.

    Returns:
        Means of every episode.
    """
    runs = plan_runs(conditions, defenders=(defender,), attacks=("attack",), ks=(k,), seeds=(seed,), batch=batch)
    return Episodes.joined([_episodes(Rollout(run, conditions, bank, copy.deepcopy(attack))) for run in runs])


def _episodes(rollout: Rollout) -> Episodes:
    worlds = rollout.world.num_envs
    totals, over = np.zeros((len(fields(Episodes)), worlds)), np.zeros(worlds, dtype=bool)
    while not over.all():
        outcome = rollout.step()
        collaborators = [verdict.collaborators for verdict in outcome.verdicts]
        out = [
            [v not in kept for v in attackers] for attackers, kept in zip(outcome.attackers, collaborators, strict=True)
        ]
        counted = [outcome.damage, np.ones(worlds), outcome.similarity, outcome.verifications, np.mean(out, axis=1)]
        totals += np.where(over, 0.0, np.stack([*counted, critical(outcome)]))
        over |= outcome.truncated
    damage, frames, *means = totals
    return Episodes(damage / frames, frames, *(total / frames for total in means))
