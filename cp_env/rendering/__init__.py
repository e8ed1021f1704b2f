"""Pictures of a frame: what was sensed, what is true, what the ego saw, who was malicious, who is suspected."""

from __future__ import annotations

from cp_env.rendering.camera import Camera
from cp_env.rendering.frame import Picture, draw, write_gif

__all__ = ["Camera", "Picture", "draw", "write_gif"]
