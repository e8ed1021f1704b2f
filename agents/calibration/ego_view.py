"""Scores of groups with the ego against the ego-only view: what the thresholds of ROBOSAC and PASAC rest on.

They compare the boxes by their Jaccard similarity (published threshold 0.3), or the score maps by their consistency
(CCLoss, published threshold 0.08, made for segmentation). The ego is benign here. Groups of one are single vehicles
other than the ego; PASAC verifies those with trust_ego=False only.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from agents.calibration.episode import watch
from agents.calibration.samples import Key, Samples, Track, best_threshold, no_samples, pooled
from cp_env.world.scene_cache import SceneBank
from defenders.protocol import Defender, Frame, Informed, Inspection, Query, Verdict

SCORES = ("agreement", "similarity")


class Instrument(Defender, Informed):
    """No defence: compares groups with the ego, and single other vehicles, with the ego-only view."""

    def reveal_attackers(self, attackers: frozenset[int]) -> None:
        self.attackers = frozenset(attackers)

    def reset(self, n_vehicles: int, rng: np.random.Generator) -> None:
        others = range(1, n_vehicles)
        teams = [frozenset({0, *g}) for size in others for g in itertools.combinations(others, size)]
        self.groups = [*teams, *(frozenset({i}) for i in others)]
        self.measured: list[tuple[Key, dict[str, float]]] = []

    def inspect(self, frame: Frame) -> Inspection:
        ego_only, *views = yield Query([{0}, *self.groups])
        for group, view in zip(self.groups, views, strict=True):
            scores = {score: getattr(frame, score)(view, ego_only) for score in SCORES}
            self.measured.append(((len(group), len(group & self.attackers)), scores))
        return Verdict({0})


def survey(
    bank: SceneBank,
    names: Sequence[str],
    *,
    n_vehicles: int,
    frames: int,
    attack: str,
    seed: int,
    track: Track[tuple[str, int]],
) -> dict[str, Samples]:
    """Both scores by size and attackers, of k = 0 … n - 1 attackers in every scene; see `previous_frame`."""
    found = {score: no_samples() for score in SCORES}
    jobs = list(itertools.product(names, range(n_vehicles)))
    for number, (name, k) in enumerate(track(jobs, "scores against the ego-only view")):
        rng = np.random.default_rng([seed, number])
        attackers = tuple(sorted((1 + rng.permutation(n_vehicles - 1)[:k]).tolist()))
        instrument = watch(
            Instrument(),
            bank,
            name,
            attack if k else "none",
            frames,
            entropy=[seed, number],
            rng=rng.spawn(1)[0],
            n_vehicles=n_vehicles,
            attackers=attackers,
            grace_frames=0,
            max_frames=frames,  # so the first frame is drawn from the whole scene
        )
        for key, scores in instrument.measured:
            for score, value in scores.items():
                found[score][key][name].append(value)
    return found


def threshold(samples: Samples, size: int) -> float:
    """The ε of a size: a view passes above it. Values between the lowest and the highest score are tried."""
    values = np.concatenate([pooled(samples, key) for key in samples if key[0] == size])
    return best_threshold(samples, size, np.linspace(values.min(), values.max(), 201)[:-1], strict=True, digits=4)


def thresholds(samples: Samples, n_vehicles: int) -> dict[int, float]:
    """ε by group size."""
    return {size: threshold(samples, size) for size in range(1, n_vehicles + 1)}
