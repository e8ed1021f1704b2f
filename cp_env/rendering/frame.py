"""The picture of one frame: everyone fused next to the output of the defended ego, or that output alone.

`Picture` holds everything that is drawn; `draw` and `draw_output` are pure functions of it. A frame takes some ten
milliseconds. Each colour and shape means one thing (`cp_env.palette.colours.DARK`):
    grey, white         LiDAR points of the others, of the ego (the ground's are darker)
    green, blue         a true vehicle that was found, and the box that the ego perceives there
    yellow, filled      a true vehicle that was missed
    purple, crossed     a box where there is no vehicle: a ghost
    orange ring, cross  an attacker, and a vehicle that the defender suspects
    disc                a vehicle whose map is fused; an empty one is not fused
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from PIL import Image, ImageDraw

from cp_env.rendering.panel import (
    FAINT,
    GROUND,
    INK,
    LEGEND_ROW,
    Image3,
    Panel,
    draw_counts,
    draw_ground,
    draw_legend,
    draw_panel,
    draw_strip,
    fitted,
    font,
)
from cp_env.rendering.picture import Picture

LEFT, RIGHT, TOP, SIDE = 8, 351, 74, 331  # of the two panels, pixels; the image is as wide as a page: 690
BELOW = TOP + SIDE + 46
SIZE = (RIGHT + SIDE + 8, BELOW + 2 * LEGEND_ROW + 18)

ALONE_TOP, ALONE_SIDE = 66, 320  # of the one panel of `draw_output`
ALONE_STRIP = ALONE_TOP + ALONE_SIDE + 48
ALONE_LEGEND = ALONE_STRIP + 38 + 24
ALONE_SIZE = (LEFT + ALONE_SIDE + 8, ALONE_LEGEND + 2 * LEGEND_ROW + 16)


def draw(picture: Picture) -> Image3:
    """The frame as an image (h, 690, 3): "everyone fused" left, the defended output right, similarity over time."""
    left, right = (Panel(x, TOP, SIDE, picture.extent) for x in (LEFT, RIGHT))
    canvas = _background(SIZE, (LEFT, BELOW - 2, (0, 104, 240))).copy()
    draw_ground(canvas, picture, (left, right))
    image = Image.fromarray(canvas)
    everyone = frozenset(range(len(picture.places)))
    all_fused = draw_panel(image, picture, left, picture.seen, everyone, frozenset(), picture.attackers)
    counts = _draw_output(image, picture, right)
    pen = ImageDraw.Draw(image)
    draw_counts(pen, left, *all_fused)
    draw_counts(pen, right, *counts)
    pen.text((LEFT, TOP - 8), "everyone fused", INK, font(15), anchor="ls")
    pen.text((RIGHT, TOP - 8), fitted(pen, picture.defended, 15, SIDE), INK, font(15), anchor="ls")
    title = fitted(pen, f"{picture.title}, attack: {picture.attack}" if picture.attack else picture.title, 16, 560)
    pen.text((LEFT, 22), title, INK, font(16), anchor="ls")
    pen.text((RIGHT + SIDE, 22), f"frame {picture.frame}", INK, font(16), anchor="rs")
    pen.text((LEFT, 43), _facts(picture), FAINT, font(13), anchor="ls")
    draw_strip(pen, picture, RIGHT, BELOW, SIDE, 2 * LEGEND_ROW)
    return np.asarray(image)


def draw_output(picture: Picture) -> Image3:
    """The output of the defended ego alone, as an image (h, 336, 3) that is legible by itself."""
    panel = Panel(LEFT, ALONE_TOP, ALONE_SIDE, picture.extent)
    canvas = _background(ALONE_SIZE, (LEFT, ALONE_LEGEND, (0, 108, 238))).copy()
    draw_ground(canvas, picture, (panel,))
    image = Image.fromarray(canvas)
    counts = _draw_output(image, picture, panel)
    pen, right = ImageDraw.Draw(image), LEFT + ALONE_SIDE
    draw_counts(pen, panel, *counts)
    pen.text((LEFT, 19), fitted(pen, picture.defended, 15, ALONE_SIDE), INK, font(15), anchor="ls")
    pen.text((LEFT, 38), fitted(pen, f"attack: {picture.attack or '–'}", 14, ALONE_SIDE), INK, font(14), anchor="ls")
    pen.text((LEFT, 57), fitted(pen, picture.title, 13, ALONE_SIDE - 80), FAINT, font(13), anchor="ls")
    pen.text((right, 57), f"frame {picture.frame}", FAINT, font(13), anchor="rs")
    draw_strip(pen, picture, LEFT, ALONE_STRIP, ALONE_SIDE, 38)
    return np.asarray(image)


def _draw_output(image: Image.Image, picture: Picture, panel: Panel) -> tuple[int, int, int]:
    marked = (picture.collaborators, picture.suspects, picture.attackers)
    return draw_panel(image, picture, panel, picture.output, *marked)


def _facts(picture: Picture) -> str:
    """The figures of the frame in a line."""
    now = picture.similarity[-1] if len(picture.similarity) else float("nan")
    facts = [
        "similarity –" if np.isnan(now) else f"similarity {now:.2f}",
        f"{picture.verifications} verification{'' if picture.verifications == 1 else 's'}",
        f"detection loss {picture.damage:.2f}",
        f"attackers {_names(picture.attackers)}",
        f"suspects {_names(picture.suspects)}",
    ]
    return "     ".join(facts)


def _names(numbers: frozenset[int]) -> str:
    return ", ".join(map(str, sorted(numbers))) or "none"


@lru_cache(maxsize=4)
def _background(size: tuple[int, int], legend: tuple[int, int, tuple[int, ...]]) -> Image3:
    """The ground with the legend: drawn once."""
    image = Image.new("RGB", size, GROUND)
    draw_legend(ImageDraw.Draw(image), *legend)
    return np.asarray(image)
