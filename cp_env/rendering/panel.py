"""The parts of a frame's picture: the street from above, markers of vehicles, similarity over time, and the legend.

A `Panel` is a square of the image, ±`extent` m round the ego; x points right (east), y up (north). Only Pillow and
NumPy are used, and no font file.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image, ImageDraw, ImageFont

from cp_env.geometry.planar import corners
from cp_env.palette.colours import DARK, Colour, rgb
from cp_env.rendering.picture import STANDING, Picture, wrong_rows
from cp_env.types import Detections

Image3 = UInt8[np.ndarray, "H W 3"]
Outline = list[tuple[float, float]]

GROUND, INK, FAINT, GRID = rgb(DARK.ground), rgb(DARK.ink), rgb(DARK.faint), rgb(DARK.grid)
STREET, OTHERS, EGO = rgb(DARK.street), rgb(DARK.others), rgb(DARK.ego)
TRUE, SEEN, MISSED, GHOST = rgb(DARK.truth), rgb(DARK.found), rgb(DARK.missed), rgb(DARK.ghost)
ATTACKER, SUSPECT = rgb(DARK.attacker), rgb(DARK.suspect)

BAR = 10.0  # m; length of the scale bar
LEGEND_ROW = 23  # pixels


@dataclass(frozen=True)
class Panel:
    """A square of the image."""

    left: int
    top: int
    side: int  # pixels
    extent: float  # m, half of its edge
    scale: float = 1.0  # of lines, markers and text

    def pixels(self, x: Float[np.ndarray, "*n"], y: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n 2"]:
        """Grid frame, m -> pixels from the panel's upper left corner."""
        scale = self.side / (2 * self.extent)
        return np.stack([(x + self.extent) * scale, (self.extent - y) * scale], axis=-1)

    def outlines(self, boxes: Float[np.ndarray, "L 5"]) -> list[Outline]:
        """Each box's corners in pixels of the panel."""
        points = corners(boxes)
        return [[(float(x), float(y)) for x, y in box] for box in self.pixels(points[..., 0], points[..., 1])]


def draw_ground(canvas: Image3, picture: Picture, panels: Sequence[Panel]) -> None:
    """Grid lines every 16 m or so and the LiDAR points of all vehicles: the ground's faintest, the ego's on top."""
    points = np.concatenate([np.empty((0, 3)), *reversed(picture.points)])
    mine = np.arange(len(points)) >= len(points) - (len(picture.points[0]) if picture.points else 0)
    low = points[:, 2] < STANDING
    for panel in panels:
        window = canvas[panel.top : panel.top + panel.side, panel.left : panel.left + panel.side]
        window[:] = GROUND
        for line in (panel.side // 4, panel.side // 2, 3 * panel.side // 4):
            window[line] = window[:, line] = GRID
        cells = panel.pixels(points[:, 0], points[:, 1]).astype(int)
        inside = ((cells >= 0) & (cells < panel.side)).all(axis=1)
        for kind, colour in ((low, STREET), (~low & ~mine, OTHERS), (~low & mine, EGO)):
            column, row = cells[inside & kind].T
            window[row, column] = colour


def draw_panel(
    image: Image.Image,
    picture: Picture,
    panel: Panel,
    boxes: Detections,
    fused: frozenset[int],
    suspects: frozenset[int],
    attackers: frozenset[int],
) -> tuple[int, int, int]:
    """Boxes and vehicles on the panel's ground; returns how many vehicles were found and missed, and the ghosts."""
    ghosts, missed = wrong_rows(boxes.boxes, picture.truth)
    corner = (panel.left, panel.top)
    square = image.crop((*corner, panel.left + panel.side, panel.top + panel.side))  # what is drawn ends at its edges
    pen, thin, wide = ImageDraw.Draw(square), round(panel.scale), round(2 * panel.scale)
    for row, outline in enumerate(panel.outlines(boxes.boxes)):
        draw_box(pen, outline, "ghost" if row in ghosts else "found", wide)
    for row, outline in enumerate(panel.outlines(picture.truth)):
        draw_box(pen, outline, "missed" if row in missed else "true", wide if row in missed else thin)
    for number, (x, y, outward) in enumerate(markers(picture, panel)):
        flags = (number in fused, number in attackers, number in suspects)
        draw_marker(pen, x, y, outward, str(number), *flags, panel.scale)
    _scale_bar(pen, panel)
    image.paste(square, corner)
    edge = (panel.left - 1, panel.top - 1, panel.left + panel.side, panel.top + panel.side)
    ImageDraw.Draw(image).rectangle(edge, outline=shade(FAINT, 2))
    return len(picture.truth) - len(missed), len(missed), len(ghosts)


def draw_box(pen: ImageDraw.ImageDraw, outline: Outline, kind: str, width: int) -> None:
    """A box: "true" and "found" are outlines, "missed" is filled, a "ghost" is crossed out."""
    colour = {"true": TRUE, "found": SEEN, "missed": MISSED, "ghost": GHOST}[kind]
    pen.polygon(outline, fill=shade(colour, 2) if kind == "missed" else None)
    if kind == "ghost":
        pen.polygon(outline, fill=shade(colour, 5))
        pen.line([outline[0], outline[2]], colour, max(width // 2, 1))
        pen.line([outline[1], outline[3]], colour, max(width // 2, 1))
    pen.polygon(outline, outline=colour, width=width)


def markers(picture: Picture, panel: Panel) -> list[tuple[float, float, tuple[float, float]]]:
    """The position of each vehicle's marker, and its direction if it is out of the picture (else (0, 0))."""
    side, margin = panel.side, 14 * panel.scale
    places = panel.pixels(picture.places[:, 0], picture.places[:, 1])
    held = places.clip(margin, side - margin - 1)
    outward = np.sign(places - held) * (np.abs(places - held) > margin)
    for number in np.flatnonzero(outward.any(axis=1)):  # side by side, where several are held at one spot
        others = np.delete(held, number, axis=0)
        axis = 1 if outward[number, 0] else 0  # along the edge, away from the nearer corner
        step = (24.0 if held[number, axis] < side / 2 else -24.0) * panel.scale
        while len(others) and (np.linalg.norm(others - held[number], axis=1) < 22 * panel.scale).any():
            held[number, axis] += step
    return [(float(x), float(y), (float(u), float(v))) for (x, y), (u, v) in zip(held, outward, strict=True)]


def draw_marker(
    pen: ImageDraw.ImageDraw,
    x: float,
    y: float,
    outward: tuple[float, float],
    text: str,
    fused: bool,
    attacker: bool,
    suspect: bool,
    scale: float = 1.0,
) -> None:
    """A numbered disc: filled if the vehicle's map is fused, ringed if malicious, crossed if suspected."""
    small, large = 9 * scale, 12.5 * scale
    if any(outward):
        u, v = 14 * scale * np.array(outward) / np.linalg.norm(outward)
        w = 0.57
        pen.polygon([(x + u, y + v), (x - w * v, y + w * u), (x + w * v, y - w * u)], fill=FAINT)
    if attacker:
        pen.ellipse((x - large, y - large, x + large, y + large), fill=ATTACKER)
    if suspect:
        for sign in (-1, 1):
            pen.line((x - large, y - large * sign, x + large, y + large * sign), SUSPECT, round(4 * scale))
    edge = INK if fused else FAINT
    pen.ellipse((x - small, y - small, x + small, y + small), fill=INK if fused else GROUND, outline=edge)
    pen.text((x, y), text, GROUND if fused else FAINT, font(round(13 * scale)), anchor="mm")


def draw_counts(pen: ImageDraw.ImageDraw, panel: Panel, found: int, missed: int, ghosts: int) -> None:
    """How many vehicles were found and missed, and the ghosts, under the panel."""
    x, y = float(panel.left), panel.top + panel.side + 14 * panel.scale
    unreal = f"{ghosts}  ghost{'' if ghosts == 1 else 's'}"
    for text, colour in ((f"{found}  found", SEEN), (f"{missed}  missed", MISSED), (unreal, GHOST)):
        pen.text((x, y), text, colour, font(round(14 * panel.scale)), anchor="lm")
        x += 82 * panel.scale


def draw_strip(pen: ImageDraw.ImageDraw, picture: Picture, left: int, top: int, width: int, height: int) -> None:
    """Similarity to the previous output, frame by frame, with the threshold the defender alarms at."""
    right, bottom = left + width - 72, top + height
    pen.text((left, top - 6), "similarity to the previous output", FAINT, font(12), anchor="ls")
    pen.rectangle((left, top, right, bottom), outline=shade(FAINT, 3))
    free = picture.threshold is None or picture.threshold * height > 12
    pen.text((right + 6, top), "1", FAINT, font(12), anchor="lm")
    if free:
        pen.text((right + 6, bottom), "0", FAINT, font(12), anchor="lm")
    if picture.threshold is not None:
        level = bottom - picture.threshold * height
        for dash in range(left, right, 8):
            pen.line((dash, level, dash + 4, level), SUSPECT)
        pen.text((right + 6, level), f"alarm {picture.threshold:.2f}", SUSPECT, font(12), anchor="lm")
    span = max(picture.horizon, len(picture.similarity), 2) - 1
    line = [
        (left + frame / span * (right - left), bottom - value * height)
        for frame, value in enumerate(picture.similarity)
        if not np.isnan(value)
    ]
    if len(line) > 1:
        pen.line(line, INK, 2)
    if line:
        x, y = line[-1]
        pen.ellipse((x - 3, y - 3, x + 3, y + 3), fill=INK)


def draw_legend(pen: ImageDraw.ImageDraw, left: int, top: int, columns: Sequence[int], scale: float = 1.0) -> None:
    """What every colour and shape means, in three columns of three; `columns` are their offsets in pixels."""
    rows, text = [top + LEGEND_ROW * scale * i for i in range(3)], font(round(12 * scale))
    names = ("true vehicle", "perceived", "missed", "ghost", "LiDAR points")
    icons = ("true", "found", "missed", "ghost", "points")
    for i, (name, icon) in enumerate(zip(names, icons, strict=True)):
        x, y = left + columns[i // 3], rows[i % 3]
        if icon == "points":
            for n, (dx, dy) in enumerate(((1, -3), (4, -2), (6, -2), (9, 0), (13, 0), (16, 1), (18, 3), (21, 3))):
                spot = (x + dx * scale, y + dy * scale)
                pen.rectangle((*spot, spot[0] + scale, spot[1] + scale), fill=EGO if n < 4 else OTHERS)
        else:
            end, half = x + 22 * scale, 5 * scale
            width = round(scale if icon == "true" else 2 * scale)
            draw_box(pen, [(x, y - half), (end, y - half), (end, y + half), (x, y + half)], icon, width)
        pen.text((x + 30 * scale, y), name, FAINT, text, anchor="lm")
    vehicles = (
        ("fused", True, False, False),
        ("not fused", False, False, False),
        ("attacker", True, True, False),
        ("suspect", False, False, True),
    )
    spots = [(left + columns[1], rows[2]), *((left + columns[2], y) for y in rows)]
    for (x, y), (name, *flags) in zip(spots, vehicles, strict=True):
        fused, attacker, suspect = flags
        draw_marker(pen, x + 11 * scale, y, (0.0, 0.0), "", fused, attacker, suspect, 0.8 * scale)
        pen.text((x + 30 * scale, y), name, FAINT, text, anchor="lm")


def fitted(pen: ImageDraw.ImageDraw, text: str, size: int, width: float) -> str:
    """The text, cut with an ellipsis where it is wider than `width` pixels."""
    if pen.textlength(text, font(size)) <= width:
        return text
    while text and pen.textlength(f"{text}…", font(size)) > width:
        text = text[:-1]
    return f"{text.rstrip()}…"


def shade(colour: Colour, parts: int) -> Colour:
    """One part of the colour on the ground."""
    red, green, blue = (((parts - 1) * g + c) // parts for g, c in zip(GROUND, colour, strict=True))
    return red, green, blue


@lru_cache(maxsize=16)
def font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """Pillow's own font, pixels high."""
    return ImageFont.load_default(size)


def _scale_bar(pen: ImageDraw.ImageDraw, panel: Panel) -> None:
    """The length of 10 m in the panel's lower left corner."""
    length, s = BAR * panel.side / (2 * panel.extent), panel.scale
    x, y = 8 * s, panel.side - 9 * s
    pen.rectangle((x - 4 * s, y - 19 * s, x + length + 4 * s, y + 5 * s), fill=GROUND)
    pen.line([(x, y - 3 * s), (x, y), (x + length, y), (x + length, y - 3 * s)], INK, round(s))
    pen.text((x + length / 2, y - 4 * s), f"{BAR:.0f} m", INK, font(round(12 * s)), anchor="mb")
