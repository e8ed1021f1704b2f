"""The options of a reset, and the plan of one world's next episode: made whole before anything changes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cp_env.settings import Settings
from cp_env.world import absence
from cp_env.world.absence import Absences
from cp_env.world.scene_cache import SceneBank
from cp_env.world.streams import PUBLIC_KEY, Stream
from defenders.registry import shown, unknown

Seed = int | np.random.SeedSequence | None
ResetOptions = Mapping[str, Any] | Sequence[Mapping[str, Any] | None] | None

KEYS = ("scene", "start", "absent")

IGNORED = "options"
"""A key without effect: PettingZoo's own API test resets with `options={"options": 1}`."""


@dataclass(frozen=True, eq=False)
class EpisodePlan:
    """One world's next episode."""

    stream: Stream  # from which the episodes after this one are drawn
    scene: str
    start: int
    attackers: tuple[int, ...]
    absent: Absences
    rng: np.random.Generator  # the defender's


def options_of(options: object, n_worlds: int) -> list[Mapping[str, Any]]:
    """One mapping a world: the same for all, or one for each. ValueError for an unknown key or a wrong number."""
    if options is None or isinstance(options, Mapping):
        each: list[Any] = [options] * n_worlds
    elif isinstance(options, Sequence) and not isinstance(options, str | bytes):
        each = list(options[: n_worlds + 1])
    else:
        raise ValueError(f"the options of a reset are a dict, not {type(options).__name__} {shown(options)}")
    if len(each) != n_worlds:
        raise ValueError(f"give options once for all worlds, or once for each of {n_worlds}; got {shown(options)}")
    for one in each:
        if not isinstance(one, Mapping | None):
            raise ValueError(f"the options of a reset are a dict, not {type(one).__name__} {shown(one)}")
        for key in one or ():
            if key not in (*KEYS, IGNORED):
                raise unknown("option of reset", key, KEYS)
    return [one or {} for one in each]


def plan_episode(
    bank: SceneBank, settings: Settings, stream: Stream, options: Mapping[str, Any], key: str = PUBLIC_KEY
) -> EpisodePlan:
    """Draw what `options` leave open. Nothing is changed; the plan holds the stream's rest.

    Raises:
        ValueError: a scene that is not in the source, a start that is no frame of it, or absences that cannot be.
    """
    scene_rng, attacker_rng = stream.generator("scene", key), stream.generator("attackers", key)
    names = bank.source.names()
    drawn = names[scene_rng.integers(len(names))]  # even where it is not used: the start below is the same then
    scene = options.get("scene", drawn)
    if not isinstance(scene, str):
        raise ValueError(f'"scene" is the name of a scene, not {shown(scene)}')
    if scene not in names and not bank.endless:
        raise unknown("scene", scene, names)
    n_frames = bank.episode(scene, settings.n_vehicles, settings.rsu).scene.n_frames
    start = options.get("start", scene_rng.integers(max(n_frames - settings.max_frames, 0) + 1))
    if isinstance(start, bool) or not isinstance(start, int | np.integer) or not 0 <= start < n_frames:
        raise ValueError(f"start must be a frame of scene {scene!r}, 0 to {n_frames - 1}, not {shown(start)}")
    chosen: Sequence[int] = settings.attackers or ()
    if settings.attackers is None:
        chosen = attacker_rng.choice(settings.n_suspects, settings.k, replace=False).tolist()
    return EpisodePlan(
        stream=stream.next(),
        scene=scene,
        start=int(start),
        attackers=tuple(sorted(int(i) for i in chosen)),
        absent=absence.checked(options.get("absent", {}), settings.n_maps),
        rng=stream.generator("defender", key),
    )
