"""Action maps: a Box in [-1, 1] becomes a perturbation δ with ‖δ‖ ≤ Δ.

    full     the raw map (C, H, W): gradient attacks use this map too (PPO on it diverges).
    basis    a few coefficients on fixed directions: black-box.
    guided   eight numbers that steer the detector's own gradient: white-box; what PPO learns on.
    stealth  the same, held back so that the ego's view resembles its last output.

Every map clips actions to [-1, 1]; NaN, infinity and wrong shapes are a ValueError.
"""

from __future__ import annotations

from cp_env.envs.actions.base import ActionMap
from cp_env.envs.actions.registry import make_action

__all__ = ["ActionMap", "make_action"]
