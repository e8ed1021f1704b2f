"""Scenes from folders in the layout of OPV2V and V2XSet."""

from __future__ import annotations

from cp_env.scenes.opv2v.source import OPV2V

__all__ = ["OPV2V"]
