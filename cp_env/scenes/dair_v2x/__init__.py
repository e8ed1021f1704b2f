"""Scenes from DAIR-V2X-C: a real vehicle and the unit at the crossing that it drives through."""

from __future__ import annotations

from cp_env.scenes.dair_v2x.source import DairV2X

__all__ = ["DairV2X"]
