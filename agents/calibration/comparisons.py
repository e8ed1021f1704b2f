"""Similarities of all groups' views to those of the frames before and to the full view: what `bayes` rests on.

Three kinds of episodes are measured:

* without an attack; then views are also compared with those of two and three frames before;
* under a *loud* attack of k = 1 … n - 1 vehicles, which shows in every view that contains it;
* under *stealthy* attacks of k vehicles, which keep each frame similar to the last; the ego fuses all vehicles.

The first frame is benign. An episode that was measured is kept on disk, so that a run that was killed goes on.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
from jaxtyping import Float

from agents.calibration.episode import watch
from agents.calibration.samples import Track
from cp_env.metrics.similarity import view_similarity_many
from cp_env.types import View
from cp_env.world.scene_cache import SceneBank
from defenders.protocol import Defender, Frame, Informed, Inspection, Query, Verdict

STEALTHY = ("in_loop:threshold=0.35,steps=6", "in_loop:threshold=0.6,steps=6", "ramp:rate=0.3,first=0.2,steps=6")
"""Attacks that keep the full view similar to the frame before."""


@dataclass(frozen=True, kw_only=True)
class Episodes:
    """Which episodes are measured.

    Attributes:
        n_vehicles: n.
        start: frame of the scene that is the first; in a shorter scene, so many frames before its end as are played.
        frames: of every scene, a benign one first.
        ages: frames between a view and its reference, at most (without an attack; else one).
        loud: an attack that shows in every view that contains it.
        stealthy: attacks that keep the full view similar to the frame before.
        seed: of attackers and noise.
    """

    n_vehicles: int = 5
    start: int = 40
    frames: int = 7
    ages: int = 3
    loud: str = "pgd"
    stealthy: tuple[str, ...] = STEALTHY
    seed: int = 7

    @property
    def n_modes(self) -> int:
        """Modes of attack: loud, and stealthy if there are any such attacks."""
        return 2 if self.stealthy else 1


class Instrument(Defender, Informed):
    """No defence: compares all groups with all groups of the frames before, and with the full view."""

    def __init__(self, ages: int, *, fuse_all: bool) -> None:
        """`fuse_all`: the ego fuses all vehicles, as stealthy attacks need; else the benign vehicles."""
        self.ages, self.fuse_all = ages, fuse_all

    def reveal_attackers(self, attackers: frozenset[int]) -> None:
        self.attackers = frozenset(attackers)

    def reset(self, n_vehicles: int, rng: np.random.Generator) -> None:
        self.benign = frozenset(range(n_vehicles)) - self.attackers
        self.groups = all_groups(n_vehicles)
        self.past: list[list[View]] = []
        self.measured: list[Float[np.ndarray, "A X X"]] = []  # [age - 1, group, earlier group] of every frame
        self.full_view: list[Float[np.ndarray, " X"]] = []

    def inspect(self, frame: Frame) -> Inspection:
        views = yield Query(self.groups)
        found = np.full((self.ages, len(views), len(views)), np.nan)
        for age, earlier in enumerate(reversed(self.past)):
            found[age] = view_similarity_many(list(product(views, earlier))).reshape(found[age].shape)
        self.measured.append(found)
        self.full_view.append(view_similarity_many([(view, frame.seen) for view in views]))
        self.past = [*self.past, views][-(1 if self.attackers else self.ages) :]
        return Verdict(frame.present if self.fuse_all else self.benign)


def all_groups(n: int) -> list[frozenset[int]]:
    """All groups; group number c - 1 has the members whose bits are set in c."""
    return [frozenset(i for i in range(n) if code >> i & 1) for code in range(1, 2**n)]


@dataclass(frozen=True)
class Measurement:
    """The similarities of one scene under one attack."""

    scene: str
    attack: str
    attackers: frozenset[int]
    similarity: Float[np.ndarray, "T A X X"]  # NaN where there was no frame so long before
    full_view: Float[np.ndarray, "T X"]  # to the full view


def survey(
    bank: SceneBank,
    names: tuple[str, ...],
    episodes: Episodes,
    folder: Path,
    track: Track[tuple[str, tuple[str, int]]],
) -> Iterator[Measurement]:
    """Every scene without an attack, and under each attack of k = 1 … n - 1 vehicles.

    Args:
        bank: scenes and detector.
        names: of the scenes.
        episodes: which are measured.
        folder: of measurements, kept for the next run.
        track: shows the progress over episodes.
    """
    e, folder = episodes, folder_of(bank, episodes, folder)
    folder.mkdir(parents=True, exist_ok=True)
    attacks = [("none", 0), *product((e.loud, *e.stealthy), range(1, e.n_vehicles))]
    for scene, (attack, k) in track(list(product(names, attacks)), "similarity of all groups"):
        path = folder / f"{scene}-{attack.replace(':', '-')}-{k}.npz"
        if not path.exists():
            one = play(bank, scene, attack, k, e)
            draft = path.with_suffix(".part.npz")
            np.savez_compressed(
                draft, attackers=sorted(one.attackers), similarity=one.similarity, full_view=one.full_view
            )
            draft.replace(path)
        with np.load(path, allow_pickle=False) as held:
            attackers = frozenset(held["attackers"].astype(int).tolist())
            yield Measurement(scene, attack, attackers, held["similarity"], held["full_view"])


def folder_of(bank: SceneBank, episodes: Episodes, root: Path) -> Path:
    """Where the measurements of such episodes are kept."""
    e, scenes = episodes, zlib.crc32(bank.source.digest.encode())
    key = (bank.detector.digest, scenes, e.n_vehicles, e.start, e.frames, e.ages, e.seed)
    return root / "-".join(map(str, key))


def play(bank: SceneBank, scene: str, attack: str, k: int, episodes: Episodes) -> Measurement:
    """One episode under the instrument."""
    entropy = [episodes.seed, zlib.crc32(scene.encode()), k, 0]
    last = max(bank.source.load(scene).n_frames - episodes.frames, 0)
    found = watch(
        Instrument(episodes.ages, fuse_all=attack in episodes.stealthy),
        bank,
        scene,
        attack,
        episodes.frames,
        entropy=entropy,
        rng=np.random.default_rng(entropy),
        start=min(episodes.start, last),
        n_vehicles=episodes.n_vehicles,
        n_attackers=k,
    )
    similarity, full_view = (np.array(table, dtype=np.float32) for table in (found.measured, found.full_view))
    return Measurement(scene, attack, found.attackers, similarity, full_view)
