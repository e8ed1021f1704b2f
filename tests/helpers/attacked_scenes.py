"""Episodes of an attack on two recorded scenes, and what it does in one situation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch

import agents
from cp_env.world.scene_cache import SceneBank
from cp_env.world.situation import Outcome
from cp_env.world.world import World
from tests.helpers import situations

MODEL = situations.detector()


FRAMES = 5


SCENES = ("calibration-urban-00", "calibration-intersection-00")


def play(
    street: SceneBank, attack: Any, defender: Any = "prbi", seed: int = 1, frames: int = FRAMES, **options: Any
) -> list[Outcome]:
    """Both scenes in lock-step, two attackers of five, none of them the ego."""
    own = {key: options.pop(key) for key in ("grace_frames", "attackers") if key in options}
    world = World(2, defender=defender, bank=street, **({"attackers": (1, 2), "max_frames": FRAMES} | own))
    for e, scene in enumerate(SCENES):
        world.reset([seed + e], [e], options={"scene": scene, "start": 0})
    attack_instance = agents.make(attack, **({"steps": 5} | options)) if isinstance(attack, str) else attack
    attack_instance.reset(2, [np.random.default_rng(seed + e) for e in range(2)])
    return [world.step(attack_instance.act(world.situation())) for _ in range(frames)]


def damage(outcomes: Sequence[Outcome]) -> float:
    return float(np.mean([outcome.damage for outcome in outcomes]))


def act(name: str, situation: Any, seed: int = 0, **options: Any) -> torch.Tensor:
    attack = agents.make(name, **options)
    attack.reset(len(situation.active), np.random.default_rng(seed))
    return attack.act(situation)
