"""Scenes from folders in the layout of OPV2V: OPV2V itself, V2XSet, V2V4Real and V2X-Real."""

from __future__ import annotations

from cp_env.scenes.opv2v.source import OPV2V
from cp_env.scenes.opv2v.v2v4real import V2V4Real
from cp_env.scenes.opv2v.v2x_real import V2XReal

__all__ = ["OPV2V", "V2V4Real", "V2XReal"]
