"""Scenes from V2X-Sim 2.0, and from coperception's preprocessed detection files."""

from __future__ import annotations

from cp_env.scenes.v2xsim.preprocessed import V2XSimDet
from cp_env.scenes.v2xsim.source import V2XSim

__all__ = ["V2XSim", "V2XSimDet"]
