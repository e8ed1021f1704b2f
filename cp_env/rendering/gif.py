"""Films of frames as small GIFs in the pictures' own colours."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np
from PIL import Image

from cp_env.rendering import panel
from cp_env.rendering.panel import FAINT, GROUND, INK, Image3, shade

STEPS = 5
"""Shades between the ground and a text's colour, for its soft edges."""


def write_gif(frames: Sequence[Image3], path: str | Path, *, fps: float = 5.0, first: int = 0) -> Path:
    """Write the frames as one endlessly repeating GIF in the picture's own colours; returns the path.

    Args:
        frames: images (h, w, 3) of one size.
        path: of the file; its folder is made if it is missing.
        fps: frames per second.
        first: the frame that the loop begins with. It is what is shown where a film does not play.

    Raises:
        ValueError: no frames, or `first` is none of them.
    """
    if not len(frames):
        raise ValueError("a GIF needs at least one frame, got none")
    if not 0 <= first < len(frames):
        raise ValueError(f"first must be one of the {len(frames)} frames, 0 to {len(frames) - 1}, got {first}")
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    palette = _palette()
    order = [*frames[first:], *frames[:first]]
    images = [Image.fromarray(frame).quantize(palette=palette, dither=Image.Dither.NONE) for frame in order]
    images[0].save(path, save_all=True, append_images=images[1:], duration=round(1000 / fps), loop=0, optimize=True)
    return path


@lru_cache(maxsize=1)
def _palette() -> Image.Image:
    """Every colour that is drawn, and steps between the ground and each colour of text for its soft edges."""
    marks = (panel.TRUE, panel.SEEN, panel.MISSED, panel.GHOST, panel.ATTACKER, panel.SUSPECT)
    colours = [GROUND, panel.GRID, panel.STREET, panel.OTHERS, panel.EGO, *marks]
    colours += [shade(panel.MISSED, 2), shade(panel.GHOST, 5), shade(FAINT, 2), shade(FAINT, 3)]
    steps = np.linspace(0, 1, STEPS)[:, None]
    for bright in (INK, FAINT):
        colours += [(int(r), int(g), int(b)) for r, g, b in np.round(GROUND + steps * np.subtract(bright, GROUND))]
    for bright in marks:
        colours.append(shade(bright, 2))
    image = Image.new("P", (1, 1))
    image.putpalette([value for colour in dict.fromkeys(colours) for value in colour])
    return image
