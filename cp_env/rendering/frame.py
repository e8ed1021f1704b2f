"""The picture of one frame: the view of everyone fused next to the output of the defended ego.

`Picture` holds everything that is drawn, in the ego's grid frame; `draw` is a pure function of it. Only Pillow and
NumPy are used, and no font file: a frame takes some ten milliseconds.

Each colour means one thing, the same in both panels:
    grey, white     LiDAR points of the others, of the ego (the ground's are darker)
    green, blue     a true vehicle that was found, and the box the ego saw there
    yellow, magenta a true vehicle that was missed, and a box where there is none (a ghost)
    red, orange     attackers, and vehicles that the defender suspects
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image, ImageDraw, ImageFont

from cp_env.geometry.planar import corners
from cp_env.metrics.similarity import match
from cp_env.types import Detections

Colour = tuple[int, int, int]
Image3 = UInt8[np.ndarray, "H W 3"]

GROUND, GRID, FRAME, INK, FAINT = (13, 16, 22), (30, 36, 46), (66, 74, 88), (230, 234, 240), (140, 149, 163)
STREET, OTHERS, EGO = (40, 47, 59), (112, 122, 138), (214, 220, 230)
TRUE, SEEN, MISSED, GHOST = (58, 190, 98), (70, 150, 255), (247, 221, 72), (238, 82, 214)
ATTACKER, SUSPECT = (240, 52, 52), (255, 140, 26)

SIDE = 400  # pixels of a panel's edge
LEFT, RIGHT, TOP = 38, 464, 82  # of the two panels; their top
STRIP_TOP = TOP + SIDE + 46
SIZE = (RIGHT + SIDE + 16, STRIP_TOP + 84)
STANDING = 0.3  # m; what is lower is ground
FOUND_AT = 0.5  # IoU at which a box counts as seen


@dataclass(frozen=True, eq=False)
class Picture:
    """The content of one frame's picture. Positions and boxes are in the ego's grid frame; m, rad."""

    frame: int
    points: Sequence[Float[np.ndarray, "_ 3"]]  # one sweep a map, the ego's first, all moved into the ego's frame
    places: Float[np.ndarray, "N 2"]  # where each map's sensor is
    truth: Float[np.ndarray, "L 5"]
    seen: Detections  # everyone fused
    output: Detections  # what the ego acts on
    attackers: frozenset[int]
    suspects: frozenset[int]
    collaborators: frozenset[int]  # fused for the output
    similarity: Sequence[float]  # of every frame so far, this one last; NaN where there was none
    verifications: int
    damage: float  # 1 - Jaccard of the output and the unattacked output
    title: str = ""
    defence: str = "defended"
    threshold: float | None = None  # ε, drawn across the similarities
    horizon: int = 100  # frames the strip has room for
    extent: float = 32.0  # m, half the edge of a panel


def draw(picture: Picture) -> Image3:
    """The frame as an image: "everyone fused" left, the defended output right, similarity over time below."""
    image = Image.fromarray(_with_points(picture))
    everyone = frozenset(range(len(picture.places)))
    _panel(image, picture, LEFT, "everyone fused", picture.seen, everyone, frozenset())
    _panel(image, picture, RIGHT, picture.defence, picture.output, picture.collaborators, picture.suspects)
    pen = ImageDraw.Draw(image)
    _header(pen, picture)
    _strip(pen, picture)
    return np.asarray(image)


def write_gif(frames: Sequence[Image3], path: str | Path, *, fps: float = 5.0) -> Path:
    """Write the frames as one endlessly repeating GIF in the picture's own colours; returns the path."""
    if not frames:
        raise ValueError("a GIF needs at least one frame, got none")
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    palette = _palette()
    images = [Image.fromarray(frame).quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    images[0].save(path, save_all=True, append_images=images[1:], duration=round(1000 / fps), loop=0, optimize=False)
    return path


def wrong_rows(boxes: Float[np.ndarray, "K 5"], truth: Float[np.ndarray, "L 5"]) -> tuple[set[int], set[int]]:
    """The boxes that are ghosts, and the true vehicles that are missed (rows of each)."""
    pairs = match(boxes, truth, FOUND_AT)
    found, known = {int(a) for a, _ in pairs}, {int(b) for _, b in pairs}
    return set(range(len(boxes))) - found, set(range(len(truth))) - known


# ── the parts ────────────────────────────────────────────────────────────────────────────────────────────────────────


def _pixels(x: Float[np.ndarray, "*n"], y: Float[np.ndarray, "*n"], extent: float) -> Float[np.ndarray, "*n 2"]:
    """Grid frame, m -> pixels of a panel; north is up."""
    scale = SIDE / (2 * extent)
    return np.stack([(x + extent) * scale, (extent - y) * scale], axis=-1)


def _with_points(picture: Picture) -> Image3:
    """The background with the LiDAR points of both panels: ground returns faintest, the ego's brightest and on top."""
    canvas = _background(picture.extent).copy()
    points = np.concatenate([np.empty((0, 3)), *reversed(picture.points)])
    mine = np.arange(len(points)) >= len(points) - (len(picture.points[0]) if picture.points else 0)
    cells = _pixels(points[:, 0], points[:, 1], picture.extent).astype(int)
    inside = ((cells >= 0) & (cells < SIDE)).all(axis=1)
    low = points[:, 2] < STANDING
    for kind, colour in ((low, STREET), (~low & ~mine, OTHERS), (~low & mine, EGO)):
        column, row = cells[inside & kind].T
        for left in (LEFT, RIGHT):
            canvas[TOP + row, left + column] = colour
    return canvas


def _panel(
    image: Image.Image,
    picture: Picture,
    left: int,
    caption: str,
    boxes: Detections,
    fused: frozenset[int],
    suspects: frozenset[int],
) -> None:
    ghosts, missed = wrong_rows(boxes.boxes, picture.truth)
    panel = image.crop((left, TOP, left + SIDE, TOP + SIDE))  # what is drawn on it ends at its edges
    pen = ImageDraw.Draw(panel)
    for row, outline in enumerate(_outlines(boxes.boxes, picture.extent)):
        _box(pen, outline, GHOST if row in ghosts else SEEN, 2 if row in ghosts else 3, row in ghosts)
    for row, outline in enumerate(_outlines(picture.truth, picture.extent)):
        _box(pen, outline, MISSED if row in missed else TRUE, 2 if row in missed else 1, row in missed)
    for number, (x, y, outward) in enumerate(_markers(picture)):
        _marker(pen, x, y, outward, str(number), number in fused, number in picture.attackers, number in suspects)
    image.paste(panel, (left, TOP))
    pen = ImageDraw.Draw(image)
    counts = f"found {len(picture.truth) - len(missed)}   missed {len(missed)}   ghosts {len(ghosts)}"
    pen.text((left, TOP - 8), caption, INK, _font(15), anchor="ls")
    pen.text((left + SIDE, TOP - 8), counts, INK, _font(13), anchor="rs")
    pen.rectangle((left - 1, TOP - 1, left + SIDE, TOP + SIDE), outline=FRAME)


def _box(pen: ImageDraw.ImageDraw, outline: list[tuple[float, float]], colour: Colour, width: int, wrong: bool) -> None:
    """A box; filled where truth and perception differ."""
    pen.polygon(outline, fill=_shade(colour, 4) if wrong else None)
    pen.polygon(outline, outline=colour, width=width)


def _outlines(boxes: Float[np.ndarray, "L 5"], extent: float) -> list[list[tuple[float, float]]]:
    """Each box's corners in pixels of a panel."""
    points = corners(boxes)
    pixels = _pixels(points[..., 0], points[..., 1], extent)
    return [[(float(x), float(y)) for x, y in box] for box in pixels]


def _markers(picture: Picture) -> list[tuple[float, float, tuple[float, float]]]:
    """The position of each vehicle's marker, and its direction if it is out of the picture (else (0, 0))."""
    places = _pixels(picture.places[:, 0], picture.places[:, 1], picture.extent)
    held = places.clip(14, SIDE - 15)
    outward = np.sign(places - held) * (np.abs(places - held) > 14)
    for number in np.flatnonzero(outward.any(axis=1)):  # side by side, where several are held at one spot
        others = np.delete(held, number, axis=0)
        axis = 1 if outward[number, 0] else 0  # along the edge, away from the nearer corner
        step = 24.0 if held[number, axis] < SIDE / 2 else -24.0
        while len(others) and (np.linalg.norm(others - held[number], axis=1) < 22).any():
            held[number, axis] += step
    return [(float(x), float(y), (float(u), float(v))) for (x, y), (u, v) in zip(held, outward, strict=True)]


def _marker(
    pen: ImageDraw.ImageDraw,
    x: float,
    y: float,
    outward: tuple[float, float],
    text: str,
    fused: bool,
    attacker: bool,
    suspect: bool,
) -> None:
    """A numbered disc: filled if the vehicle's map is fused, ringed red if malicious, crossed if suspected."""
    if any(outward):
        u, v = np.array(outward) / np.linalg.norm(outward)
        pen.polygon([(x + 14 * u, y + 14 * v), (x - 8 * v, y + 8 * u), (x + 8 * v, y - 8 * u)], fill=FAINT)
    if attacker:
        pen.ellipse((x - 12, y - 12, x + 12, y + 12), fill=ATTACKER)
    if suspect:
        for sign in (-1, 1):
            pen.line((x - 13, y - 13 * sign, x + 13, y + 13 * sign), SUSPECT, 4)
    pen.ellipse((x - 9, y - 9, x + 9, y + 9), fill=INK if fused else GROUND, outline=INK if fused else FAINT)
    pen.text((x, y), text, GROUND if fused else FAINT, _font(13), anchor="mm")


def _header(pen: ImageDraw.ImageDraw, picture: Picture) -> None:
    pen.text((LEFT, 24), picture.title, INK, _font(17), anchor="ls")
    pen.text((RIGHT + SIDE, 24), f"frame {picture.frame}", INK, _font(17), anchor="rs")
    now = picture.similarity[-1] if len(picture.similarity) else float("nan")
    facts = [
        "similarity –" if np.isnan(now) else f"similarity {now:.2f}",
        f"{picture.verifications} verification{'' if picture.verifications == 1 else 's'}",
        f"damage {picture.damage:.2f}",
        f"attackers {_names(picture.attackers)}",
        f"suspects {_names(picture.suspects)}",
    ]
    pen.text((LEFT, 47), "    ".join(facts), FAINT, _font(13), anchor="ls")


def _names(numbers: frozenset[int]) -> str:
    return ", ".join(map(str, sorted(numbers))) or "none"


def _strip(pen: ImageDraw.ImageDraw, picture: Picture) -> None:
    """Similarity to the previous output, frame by frame, with the threshold the defender alarms at."""
    left, right, bottom, top = RIGHT, RIGHT + SIDE - 66, STRIP_TOP + 66, STRIP_TOP + 4
    span = max(picture.horizon, len(picture.similarity), 2) - 1
    pen.text((right + 8, top), "1", FAINT, _font(11), anchor="lm")
    pen.text((right + 8, bottom), "0", FAINT, _font(11), anchor="lm")
    if picture.threshold is not None:
        level = bottom - picture.threshold * (bottom - top)
        for dash in range(left, right, 8):
            pen.line((dash, level, dash + 4, level), FAINT)
        pen.text((right + 8, level), f"alarm {picture.threshold:.2f}", FAINT, _font(11), anchor="lm")
    line: list[tuple[float, float]] = []
    for frame, value in enumerate(picture.similarity):
        if not np.isnan(value):
            line.append((left + frame / span * (right - left), bottom - value * (bottom - top)))
    if len(line) > 1:
        pen.line(line, INK, 2)
    if line:
        x, y = line[-1]
        pen.ellipse((x - 3, y - 3, x + 3, y + 3), fill=INK)


# ── what every frame shares ──────────────────────────────────────────────────────────────────────────────────────────


@lru_cache(maxsize=1)
def _palette() -> Image.Image:
    """Every colour that is drawn, and steps between ground and text for its soft edges."""
    colours = [GRID, FRAME, STREET, OTHERS, EGO, TRUE, SEEN, MISSED, GHOST, ATTACKER, SUSPECT]
    colours += [_shade(MISSED, 4), _shade(GHOST, 4)]
    steps = np.linspace(0, 1, 9)[:, None]
    for bright in (INK, FAINT):
        colours += [(int(r), int(g), int(b)) for r, g, b in np.round(GROUND + steps * np.subtract(bright, GROUND))]
    image = Image.new("P", (1, 1))
    image.putpalette([value for colour in dict.fromkeys(colours) for value in colour])
    return image


def _shade(colour: Colour, parts: int) -> Colour:
    """One part of the colour on the ground."""
    red, green, blue = (((parts - 1) * g + c) // parts for g, c in zip(GROUND, colour, strict=True))
    return red, green, blue


@lru_cache(maxsize=16)
def _font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size)


@lru_cache(maxsize=4)
def _background(extent: float) -> Image3:
    """Grid, axes, legend and the strip's frame: drawn once."""
    image = Image.new("RGB", SIZE, GROUND)
    pen = ImageDraw.Draw(image)
    ticks = np.arange(-extent, extent + 1, extent / 2)
    for left in (LEFT, RIGHT):
        for value, (across, up) in zip(ticks, _pixels(ticks, ticks, extent) + np.array([left, TOP]), strict=True):
            pen.line((across, TOP, across, TOP + SIDE - 1), GRID)
            pen.line((left, up, left + SIDE - 1, up), GRID)
            unit = " m" if value == ticks[-1] else ""
            pen.text((across, TOP + SIDE + 6), f"{value:.0f}{unit}", FAINT, _font(11), anchor="mt")
            if left == LEFT:
                pen.text((left - 6, up), f"{value:.0f}", FAINT, _font(11), anchor="rm")
    _legend(pen)
    top, bottom, right = STRIP_TOP + 4, STRIP_TOP + 66, RIGHT + SIDE - 66
    pen.text((RIGHT, top - 8), "similarity to the previous output, frame by frame", FAINT, _font(11), anchor="ls")
    pen.rectangle((RIGHT, top, right, bottom), outline=GRID)
    return np.asarray(image)


def _legend(pen: ImageDraw.ImageDraw) -> None:
    """Three columns under the left panel: points, boxes, vehicles."""
    rows = [STRIP_TOP + 8 + 26 * i for i in range(3)]
    boxes = (("true vehicle", TRUE, 1), ("the ego's box", SEEN, 3), ("missed", MISSED, 2), ("ghost", GHOST, 2))
    for i, (name, colour, width) in enumerate(boxes):
        x, y = LEFT + 130 * (i // 2), rows[i % 2]
        _box(pen, [(x, y - 5), (x + 22, y - 5), (x + 22, y + 5), (x, y + 5)], colour, width, i > 1)
        pen.text((x + 32, y), name, FAINT, _font(12), anchor="lm")
    for i, (name, colour) in enumerate((("ego's points", EGO), ("others' points", OTHERS))):
        x, y = LEFT + 130 * i, rows[2]
        for dx, dy in ((2, -3), (4, -2), (7, -2), (9, 0), (12, 0), (15, 1), (17, 3), (20, 3)):
            pen.point((x + dx, y + dy), colour)
        pen.text((x + 32, y), name, FAINT, _font(12), anchor="lm")
    vehicles = (("fused", True, False, False), ("attacker", True, True, False), ("suspect", False, False, True))
    for y, (name, *flags) in zip(rows, vehicles, strict=True):
        _marker(pen, LEFT + 284, y, (0.0, 0.0), "", *flags)
        pen.text((LEFT + 306, y), name, FAINT, _font(12), anchor="lm")
