"""Scenes from nuScenes: one vehicle, for detectors and for similarities without an attack."""

from __future__ import annotations

from cp_env.scenes.nuscenes.source import NuScenes

__all__ = ["NuScenes"]
