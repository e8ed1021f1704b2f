"""Action maps by name."""

from __future__ import annotations

from cp_env.envs.actions.base import ActionMap
from cp_env.envs.actions.black_box import Basis, Full
from cp_env.envs.actions.guided import Guided
from cp_env.envs.actions.lane_aimed import LaneAimed
from cp_env.envs.actions.similarity_bounded import SimilarityBounded
from cp_env.settings import ACTIONS, choose

_MAPS: dict[str, type[Full] | type[Basis] | type[Guided]] = {
    "full": Full,
    "basis": Basis,
    "guided": Guided,
    "stealth": SimilarityBounded,
    "critical": LaneAimed,
}


def make_action(name: str, channels: int, size: int, precision: str | None = None) -> ActionMap:
    """The action map called `name`.

    Args:
        name: one of `ACTIONS`.
        channels: C of the shared maps.
        size: H = W of the shared maps.
        precision: of the gradients that the map takes; the detector's own by default.

    Raises:
        ValueError: an unknown name, or a precision for a map that takes no gradient.
    """
    made = _MAPS[choose("action map", name, ACTIONS)]
    if precision is None:
        return made(channels, size)
    if not issubclass(made, Guided):
        guided = ", ".join(one for one, kind in _MAPS.items() if issubclass(kind, Guided))
        raise ValueError(
            f"gradient_precision = {precision!r} is for actions that take a gradient ({guided}), not for {name!r}"
        )
    return made(channels, size, precision)
