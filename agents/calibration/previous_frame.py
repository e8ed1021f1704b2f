"""Similarity, Eq. (5), of every group's view to the benign view of the frame before: what PRBI's thresholds rest on.

PRBI (Sec. 11.1) judges every group by one threshold, 0.35. Here each size of group gets its own.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from agents.calibration.episode import watch
from agents.calibration.samples import Key, Samples, Track, best_threshold, no_samples
from cp_env.world.scene_cache import SceneBank
from defenders.protocol import Defender, Frame, Informed, Inspection, Query, Verdict

GRID = np.arange(0.02, 0.99, 0.01)
"""Thresholds that are tried."""


class Instrument(Defender, Informed):
    """No defence: compares every group with the view of the benign vehicles in the frame before."""

    def reveal_attackers(self, attackers: frozenset[int]) -> None:
        self.attackers = frozenset(attackers)

    def reset(self, n_vehicles: int, rng: np.random.Generator) -> None:
        self.benign = frozenset(range(n_vehicles)) - self.attackers
        numbers = range(n_vehicles)
        self.groups = [frozenset(g) for size in range(1, n_vehicles + 1) for g in itertools.combinations(numbers, size)]
        self.reference = None
        self.measured: list[tuple[Key, float]] = []

    def inspect(self, frame: Frame) -> Inspection:
        views = yield Query(self.groups)
        if self.reference is not None:
            for group, view in zip(self.groups, views, strict=True):
                key = len(group), len(group & self.attackers)
                self.measured.append((key, frame.similarity(view, self.reference)))
        self.reference = views[self.groups.index(self.benign)]
        return Verdict(self.benign, self.attackers)


def survey(
    bank: SceneBank,
    names: Sequence[str],
    *,
    n_vehicles: int,
    frames: int,
    attack: str,
    seed: int,
    track: Track[tuple[str, int]],
) -> Samples:
    """Similarities by size and attackers, of k = 0 … n - 1 attackers in every scene.

    Args:
        bank: scenes and detector.
        names: of the scenes.
        n_vehicles: n.
        frames: of every scene, from a drawn one on; the first is the reference of the second.
        attack: which the attackers play.
        seed: of starts, attackers and noise.
        track: shows the progress over episodes.
    """
    found = no_samples()
    jobs = list(itertools.product(names, range(n_vehicles)))
    for number, (name, k) in enumerate(track(jobs, "similarity to the frame before")):
        instrument = watch(
            Instrument(),
            bank,
            name,
            attack if k else "none",
            frames,
            entropy=[seed, number],
            rng=np.random.default_rng([seed, number]).spawn(1)[0],
            n_vehicles=n_vehicles,
            n_attackers=k,
            grace_frames=0,
            max_frames=frames,  # so the first frame is drawn from the whole scene
        )
        for key, value in instrument.measured:
            found[key][name].append(value)
    return found


def thresholds(samples: Samples, n_vehicles: int) -> dict[int, float]:
    """ε by group size: a view passes from ε on."""
    return {size: best_threshold(samples, size, GRID, strict=False, digits=2) for size in range(1, n_vehicles + 1)}
