"""One episode under an instrument: a defender that is given the attackers, and defends nothing but measures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar, Unpack

import numpy as np

import agents
from cp_env.settings import Options
from cp_env.world.scene_cache import SceneBank
from cp_env.world.world import World
from defenders.protocol import Defender

Instrument = TypeVar("Instrument", bound=Defender)


def watch(
    instrument: Instrument,
    bank: SceneBank,
    scene: str,
    attack: str,
    frames: int,
    *,
    entropy: Sequence[int],
    rng: np.random.Generator,
    start: int | None = None,
    **options: Unpack[Options],
) -> Instrument:
    """Play so many frames of a scene, fewer if it ends before.

    Args:
        instrument: what measures; the world plays a copy of it.
        bank: scenes and detector.
        scene: its name.
        attack: of the attackers; with none of them it sends nothing.
        frames: how many.
        entropy: of the start, the attackers and the instrument.
        rng: of the attack.
        start: the first frame; by default one is drawn, from which on `max_frames` are left.
        **options: of the world.

    Returns:
        The instrument that watched.

    Raises:
        RuntimeError: the instrument broke a rule of the referee, which ends an episode without a measurement.
    """
    world = World(1, defender=instrument, bank=bank, **options)
    first = {} if start is None else {"start": start}
    world.reset([np.random.SeedSequence(entropy)], options={"scene": scene, **first})
    playing = agents.make(attack)
    playing.reset(1, [rng])
    (episode, begin), *_ = world.places
    for _ in range(min(frames, episode.scene.n_frames - begin)):
        outcome = world.step(playing.act(world.situation()))
        if any(outcome.errors):
            raise RuntimeError(f"the instrument failed: {outcome.errors}")
    (watched,) = world.defenders
    assert isinstance(watched, type(instrument))
    return watched
