"""Pictures of a frame: what was sensed, what is true, what the ego saw, who was malicious, who is suspected."""

from __future__ import annotations

from cp_env.rendering.camera import Camera
from cp_env.rendering.frame import draw, draw_output
from cp_env.rendering.gif import write_gif
from cp_env.rendering.picture import Picture

__all__ = ["Camera", "Picture", "draw", "draw_output", "write_gif"]
