"""The options of a reset, and the plan of one world's next episode: made whole before anything changes."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cp_env.settings import Settings
from cp_env.world import absence
from cp_env.world.absence import Absences
from cp_env.world.scene_cache import SceneBank
from defenders.registry import unknown

Seed = int | np.random.SeedSequence | None
ResetOptions = Mapping[str, Any] | Sequence[Mapping[str, Any] | None] | None

KEYS = ("scene", "start", "absent")

IGNORED = "options"
"""A key without effect: PettingZoo's own API test resets with `options={"options": 1}`."""


@dataclass(frozen=True, eq=False)
class EpisodePlan:
    """One world's next episode."""

    seeds: np.random.SeedSequence  # the stream from which the episodes after this one are drawn
    scene: str
    start: int
    attackers: tuple[int, ...]
    absent: Absences
    rng: np.random.Generator  # the defender's


def sequence_of(seed: object) -> np.random.SeedSequence:
    """The stream that a seed begins. ValueError for what is no seed."""
    if isinstance(seed, np.random.SeedSequence):
        return seed
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise ValueError(f"a seed is a whole number >= 0, not {seed!r:.80}")
    return np.random.SeedSequence(int(seed))


def options_of(options: object, n_worlds: int) -> list[Mapping[str, Any]]:
    """One mapping a world: the same for all, or one for each. ValueError for an unknown key or a wrong number."""
    if options is None or isinstance(options, Mapping):
        each: list[Any] = [options] * n_worlds
    elif isinstance(options, Sequence) and not isinstance(options, str | bytes):
        each = list(options)
    else:
        raise ValueError(f"the options of a reset are a dict, not {type(options).__name__} {options!r:.80}")
    if len(each) != n_worlds:
        raise ValueError(f"give options once for all worlds, or once for each of {n_worlds}; got {len(each)}")
    for one in each:
        if not isinstance(one, Mapping | None):
            raise ValueError(f"the options of a reset are a dict, not {type(one).__name__} {one!r:.80}")
        for key in one or ():
            if key not in (*KEYS, IGNORED):
                raise unknown("option of reset", key, KEYS)
    return [one or {} for one in each]


def plan_episode(
    bank: SceneBank, settings: Settings, seeds: np.random.SeedSequence, options: Mapping[str, Any]
) -> EpisodePlan:
    """Draw what `options` leave open. Neither `seeds` nor anything else is changed; the plan holds the stream's rest.

    Raises:
        ValueError: a scene that is not in the source, a start that is no frame of it, or absences that cannot be.
    """
    seeds = copy.deepcopy(seeds)
    scene_rng, attacker_rng, defender_rng = (np.random.default_rng(child) for child in seeds.spawn(3))
    names = bank.source.names()
    drawn = names[scene_rng.integers(len(names))]  # even where it is not used: the start below is the same then
    scene = options.get("scene", drawn)
    if not isinstance(scene, str):
        raise ValueError(f'"scene" is the name of a scene, not {scene!r:.80}')
    if scene not in names and not bank.endless:
        raise unknown("scene", scene, names)
    n_frames = bank.episode(scene, settings.n_vehicles, settings.rsu).scene.n_frames
    start = options.get("start", scene_rng.integers(max(n_frames - settings.max_frames, 0) + 1))
    if isinstance(start, bool) or not isinstance(start, int | np.integer) or not 0 <= start < n_frames:
        raise ValueError(f"start must be a frame of scene {scene!r}, 0 to {n_frames - 1}, not {start!r:.80}")
    chosen: Sequence[int] = settings.attackers or ()
    if settings.attackers is None:
        chosen = attacker_rng.choice(settings.n_vehicles, settings.k, replace=False).tolist()
    return EpisodePlan(
        seeds=seeds,
        scene=scene,
        start=int(start),
        attackers=tuple(sorted(int(i) for i in chosen)),
        absent=absence.checked(options.get("absent", {}), settings.n_maps),
        rng=defender_rng,
    )
