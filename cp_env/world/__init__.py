"""E worlds stepped together: the scene, the channel, the detector, and one defender each."""

from __future__ import annotations

from cp_env.world.scene_cache import SceneBank
from cp_env.world.situation import Outcome, Situation
from cp_env.world.world import World

__all__ = ["Outcome", "SceneBank", "Situation", "World"]
