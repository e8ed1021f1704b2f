"""Action maps by name."""

from __future__ import annotations

from collections.abc import Callable

from cp_env.envs.actions.base import ActionMap
from cp_env.envs.actions.black_box import Basis, Full
from cp_env.envs.actions.guided import Guided
from cp_env.envs.actions.lane_aimed import LaneAimed
from cp_env.envs.actions.similarity_bounded import SimilarityBounded
from cp_env.settings import ACTIONS, choose

_MAPS: dict[str, Callable[[int, int], ActionMap]] = {
    "full": Full,
    "basis": Basis,
    "guided": Guided,
    "stealth": SimilarityBounded,
    "critical": LaneAimed,
}


def make_action(name: str, channels: int, size: int) -> ActionMap:
    """The action map called `name`, for shared maps of (channels, size, size)."""
    return _MAPS[choose("action map", name, ACTIONS)](channels, size)
