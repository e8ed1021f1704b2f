"""Previews of any source: a GIF of what all sensors see from above, and figures of how often vehicles are seen.

Convention: the GIF follows the ego; x points east (right), y north (up), as in `cp_env.types`; m. A box's line points
to its front, so that points outside their box, a mirrored axis or a turned heading show at once. Shapes differ as well
as colours, as in all pictures: what no sensor sees is filled, and a box that its returns miss is crossed out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from PIL import Image, ImageDraw, ImageFont

from cp_env.geometry.planar import corners
from cp_env.lidar.returns import returns_of
from cp_env.palette.colours import DARK, ORANGE, SKY, VERMILLION, Colour, rgb
from cp_env.progress import Progress
from cp_env.scenes.preview.box_fit import Fit, fit
from cp_env.scenes.preview.classes import classes_of
from cp_env.types import Scene, SceneSource, Sweep

Image3 = UInt8[np.ndarray, "H W 3"]

SEEN_AT = 3  # returns that make a vehicle count as seen
SIDE, LEFT, TOP = 600, 46, 58  # pixels: edge and place of the map
SIZE = (LEFT + SIDE + 16, TOP + SIDE + 84)
GROUND, GRID, INK, FAINT = rgb(DARK.ground), rgb(DARK.grid), rgb(DARK.ink), rgb(DARK.faint)
WALL, MET, UNMET, MISSED = rgb("#6C7684"), rgb(DARK.truth), rgb(DARK.missed), rgb(DARK.ghost)
SPARE = "#9AA7FF", "#C9A27A", "#7FD3DE", "#B3B94A", "#B5838D", "#8FA3B8"
AGENTS: tuple[Colour, ...] = tuple(map(rgb, (DARK.ego, SKY, ORANGE, VERMILLION, *SPARE)))
"""Of the sensors' points and carriers. No hue of a box is among them; beyond a few, numbers tell them apart."""
UNIT: Colour = rgb("#C8A2FF")


@dataclass(frozen=True, eq=False)
class Excerpt:
    """Some frames of one scene with their sweeps: read once, for the figures and for the film."""

    source: SceneSource
    scene: Scene
    frames: Sequence[int]
    sweeps: Sequence[Sequence[Sweep]]  # [frame][agent]


@dataclass(frozen=True, eq=False)
class Figures:
    """What the sensors of one scene see, over the frames used."""

    scene: Scene
    frames: Int[np.ndarray, " F"]
    points: Int[np.ndarray, "F A"]  # of each sweep
    reach: Float[np.ndarray, "F A"]  # distance that 99 % of its points stay below; m
    hits: Int[np.ndarray, "F A M"]  # returns of each agent from each vehicle
    present: Int[np.ndarray, " F"]  # vehicles in the scene
    classes: tuple[str, ...]  # of each vehicle
    told: bool  # whether the source names the classes; they are guessed from sizes where it does not
    fits: tuple[tuple[Fit, ...], ...]  # [frame][agent]: whether returns lie in their boxes

    @property
    def seen(self) -> Float[np.ndarray, " M"]:
        """Share of the frames it is present in that any agent sees each vehicle in; NaN if it never is."""
        return self._share(self.hits.max(axis=1))

    @property
    def seen_by_ego(self) -> Float[np.ndarray, " M"]:
        return self._share(self.hits[:, 0])

    def _share(self, hits: Int[np.ndarray, "F M"]) -> Float[np.ndarray, " M"]:
        there = np.isfinite(self.scene.pose[self.frames, :, 0])
        total = there.sum(axis=0)
        met = ((hits >= SEEN_AT) & there).sum(axis=0)
        return np.where(total > 0, met / np.maximum(total, 1), np.nan)

    @property
    def redundancy(self) -> Float[np.ndarray, " A"]:
        """Share of the vehicles in a frame that one agent or more, two or more, ... see; mean over the frames."""
        there = np.isfinite(self.scene.pose[self.frames, :, 0])
        seers = (self.hits >= SEEN_AT).sum(axis=1)[there]
        return np.array([(seers >= n + 1).mean() for n in range(self.hits.shape[1])])

    @property
    def speed(self) -> Float[np.ndarray, "T M"]:
        """Of every vehicle from one of the scene's frames to the next; m/s, NaN where it is absent in either."""
        step = np.diff(self.scene.pose[..., :2], axis=0)
        return np.asarray(np.linalg.norm(step, axis=2) / self.scene.dt)

    @property
    def nearest(self) -> Float[np.ndarray, " M"]:
        """How near each vehicle comes to the ego; m, NaN if it is never there."""
        place = self.scene.pose[self.frames, :, :2]
        gap = np.linalg.norm(place - place[:, self.scene.connected[:1]], axis=-1)
        least = np.where(np.isnan(gap), np.inf, gap).min(axis=0)
        return np.where(np.isinf(least), np.nan, least)


def excerpt(source: SceneSource, name: str, frames: Sequence[int]) -> Excerpt:
    """Some frames of a scene, with a bar or lines of progress while they are read.

    Raises:
        ValueError: no frames, unknown scene, or broken data.
    """
    if not len(frames):
        raise ValueError("a preview needs at least one frame, got none")
    scene, chosen = source.load(name), [int(t) for t in frames]
    sweeps: list[Sequence[Sweep]] = []
    with Progress(f"reading {name}", len(chosen), "frame") as progress:
        for start in range(0, len(chosen), 8):
            sweeps += source.sweeps(scene, chosen[start : start + 8])
            progress.to(len(sweeps))
    return Excerpt(source, scene, chosen, sweeps)


def figures(part: Excerpt) -> Figures:
    """What the sensors see in these frames."""
    scene, frames, films = part.scene, np.asarray(part.frames), part.sweeps
    classes, told = classes_of(part.source, scene)
    return Figures(
        scene=scene,
        frames=frames,
        points=np.array([[len(sweep.points) for sweep in sweeps] for sweeps in films]),
        reach=np.array([[_reach(sweep) for sweep in sweeps] for sweeps in films]),
        hits=np.array(
            [[returns_of(scene, t, sweep) for sweep in sweeps] for t, sweeps in zip(part.frames, films, strict=True)]
        ),
        present=np.isfinite(scene.pose[frames, :, 0]).sum(axis=1),
        classes=classes,
        told=told,
        fits=tuple(
            tuple(fit(scene, t, agent, sweep) for agent, sweep in enumerate(sweeps))
            for t, sweeps in zip(part.frames, films, strict=True)
        ),
    )


def _reach(sweep: Sweep) -> float:
    return float(np.quantile(np.linalg.norm(sweep.points[:, :2], axis=1), 0.99))


def draw(scene: Scene, frame: int, sweeps: Sequence[Sweep], *, extent: float = 48.0) -> Image3:
    """One frame from above, ±`extent` m round the ego."""
    ego = scene.pose[frame, scene.connected[0], :2]
    canvas = np.array(_background(extent))
    colours = [UNIT if k == scene.n_connected else AGENTS[k % len(AGENTS)] for k in range(len(sweeps))]
    for sweep, colour in reversed(list(zip(sweeps, colours, strict=True))):  # the ego's points on top
        cells = _pixels(sweep.points[:, :2] + (sweep.origin[:2] - ego).astype(sweep.points.dtype), extent).astype(int)
        inside = ((cells >= 0) & (cells < SIDE)).all(axis=1)
        for low, shown in ((True, _dim(colour)), (False, colour)):
            column, row = cells[inside & ((sweep.points[:, 2] < 0.3) == low)].T
            canvas[TOP + row, LEFT + column] = shown
    image = Image.fromarray(canvas)
    panel = image.crop((LEFT, TOP, LEFT + SIDE, TOP + SIDE))  # what is drawn on it ends at its edges
    pen = ImageDraw.Draw(panel)
    _walls(pen, scene, ego, extent)
    met = np.max([returns_of(scene, frame, sweep) for sweep in sweeps], axis=0) >= SEEN_AT
    missed = np.zeros(len(scene.size), dtype=np.bool_)
    for agent, sweep in enumerate(sweeps):
        one = fit(scene, frame, agent, sweep)
        missed[one.rows[one.missed]] = True
    _vehicles(pen, scene, frame, ego, met, missed, colours, extent)
    image.paste(panel, (LEFT, TOP))
    _words(ImageDraw.Draw(image), scene, frame, sweeps, met, missed, colours)
    return np.asarray(image)


def film(part: Excerpt, *, extent: float = 48.0) -> list[Image.Image]:
    """The frames as pictures in few colours, ready for a GIF."""
    shots = [
        Image.fromarray(draw(part.scene, t, sweeps, extent=extent))
        for t, sweeps in zip(part.frames, part.sweeps, strict=True)
    ]
    return [shot.quantize(palette=_palette(), dither=Image.Dither.NONE) for shot in shots]


def write_gif(shots: Sequence[Image.Image], out: Path, *, seconds: float) -> None:
    """Store pictures as an endlessly repeating GIF, each shown for `seconds`."""
    out.parent.mkdir(parents=True, exist_ok=True)
    shots[0].save(out, save_all=True, append_images=shots[1:], duration=round(1000 * seconds), loop=0)


def spec_of(text: str) -> str:
    """The name of the source that a path or a name stands for: a path is inspected, the rest is returned as it is.

    Raises:
        ValueError: a path to something of no known kind.
    """
    path = Path(text)
    if not path.exists():
        return text
    if path.is_file():
        kind = "sumo" if {".sumocfg", ".cfg", ".net"} & set(path.suffixes) else ""
    elif any(path.glob("scene.json")) or any(path.glob("*/scene.json")):
        kind = "nuscenes" if any(path.glob("samples/LIDAR_TOP")) else "v2x-sim"
    elif any(path.glob("cooperative/data_info.json")) or any(path.glob("*/cooperative/data_info.json")):
        kind = "dair-v2x"
    elif any(path.glob("agent*")) or any(path.glob("*/agent*")):
        kind = "v2x-sim-det"
    else:
        kind = "opv2v" if any(path.glob("*/*/*.pcd")) or any(path.glob("*/*/*/*.pcd")) else ""
    if not kind:
        raise ValueError(f"{path} is no data set that is known here; name it as kind:path, see docs/scenes.md")
    return f"{kind}:{text}"


# ── the parts ────────────────────────────────────────────────────────────────────────────────────────────────────────


def _pixels(place: Float[np.ndarray, "*n 2"], extent: float) -> Float[np.ndarray, "*n 2"]:
    """m from the ego to pixels of the map; north is up."""
    return (place * [1, -1] + extent) * (SIDE / (2 * extent))


def _corners(boxes: Float[np.ndarray, "*n 5"], extent: float) -> list[list[tuple[float, float]]]:
    return [[(float(x), float(y)) for x, y in box] for box in _pixels(corners(boxes), extent)]


def _walls(pen: ImageDraw.ImageDraw, scene: Scene, ego: Float[np.ndarray, " 2"], extent: float) -> None:
    rows = scene.obstacles
    boxes = np.column_stack([rows[:, :2] - ego, rows[:, 3:5], rows[:, 2]])
    for outline in _corners(boxes, extent):
        pen.polygon(outline, outline=WALL)


def _vehicles(
    pen: ImageDraw.ImageDraw,
    scene: Scene,
    frame: int,
    ego: Float[np.ndarray, " 2"],
    met: Bool[np.ndarray, " M"],
    missed: Bool[np.ndarray, " M"],
    colours: Sequence[Colour],
    extent: float,
) -> None:
    rows = np.flatnonzero(np.isfinite(scene.pose[frame, :, 0]))
    pose = scene.pose[frame, rows]
    boxes = np.column_stack([pose[:, :2] - ego, scene.size[rows, :2], pose[:, 2]])
    number = {int(row): k for k, row in enumerate(scene.connected)}
    for row, box, outline in zip(rows.tolist(), boxes, _corners(boxes, extent), strict=True):
        k = number.get(row)
        colour = colours[k] if k is not None else MET if met[row] else UNMET
        middle = _pixels(box[:2], extent)
        front = (np.array(outline[0]) + np.array(outline[3])) / 2
        edge = MISSED if missed[row] else colour
        fill = GROUND if k is not None else _shade(UNMET) if edge == UNMET else None
        _box(pen, outline, edge, fill, crossed=bool(missed[row]))
        pen.line([*middle.tolist(), *front.tolist()], fill=edge, width=2)
        if k is not None:
            spot = (float(middle[0]), float(middle[1]))
            pen.text(spot, str(k), colour, _font(15), anchor="mm", stroke_width=3, stroke_fill=GROUND)
    if scene.rsu is not None:
        _unit(pen, *_pixels(scene.rsu[:2] - ego, extent).tolist())


def _box(
    pen: ImageDraw.ImageDraw, outline: list[tuple[float, float]], edge: Colour, fill: Colour | None, *, crossed: bool
) -> None:
    """One box: an outline, filled or not, crossed out or not."""
    pen.polygon(outline, outline=edge, width=1 if edge == WALL else 2, fill=fill)
    if crossed:
        pen.line([outline[0], outline[2]], edge)
        pen.line([outline[1], outline[3]], edge)


def _unit(pen: ImageDraw.ImageDraw, x: float, y: float) -> None:
    """The road-side unit's triangle."""
    pen.polygon([(x, y - 8), (x + 7, y + 5), (x - 7, y + 5)], outline=UNIT, fill=GROUND, width=2)


def _shade(colour: Colour) -> Colour:
    """Half-way to the ground: of areas."""
    red, green, blue = ((a + b) // 2 for a, b in zip(colour, GROUND, strict=True))
    return red, green, blue


def _dim(colour: Colour) -> Colour:
    """A third of the way from the ground: of points on the road."""
    red, green, blue = ((2 * g + c) // 3 for g, c in zip(GROUND, colour, strict=True))
    return red, green, blue


def _words(
    pen: ImageDraw.ImageDraw,
    scene: Scene,
    frame: int,
    sweeps: Sequence[Sweep],
    met: Bool[np.ndarray, " M"],
    missed: Bool[np.ndarray, " M"],
    colours: Sequence[Colour],
) -> None:
    present = np.isfinite(scene.pose[frame, :, 0])
    pen.text((LEFT, 12), scene.name, INK, _font(16))
    clock = f"frame {frame} of {scene.n_frames}, {frame * scene.dt:.1f} s"
    pen.text((LEFT + SIDE, 14), clock, INK, _font(13), anchor="ra")
    total = sum(len(sweep.points) for sweep in sweeps)
    counts = f"{present.sum()} vehicles, {(met & present).sum()} of them seen by a sensor; {total:,} points"
    if missed.any():
        counts += f"; returns miss {missed.sum()} boxes"
    pen.text((LEFT, 36), counts, FAINT, _font(12))
    x, y = LEFT, TOP + SIDE + 44
    for k, colour in enumerate(colours):
        name = "road-side unit" if k == scene.n_connected else "sensor 0, the ego" if k == 0 else str(k)
        if k == scene.n_connected:
            _unit(pen, x + 5, y)
        else:
            pen.rectangle((x, y - 5, x + 10, y + 5), fill=colour)
        pen.text((x + 15, y), name, FAINT, _font(12), anchor="lm")
        x += 29 + round(pen.textlength(name, _font(12)))
    x, y = LEFT, TOP + SIDE + 66
    kinds = (("seen", MET), ("seen by no sensor", UNMET), ("returns miss its box", MISSED), ("wall or building", WALL))
    for name, colour in kinds:
        outline = [(x + 18.0, y - 5.0), (x + 18.0, y + 5.0), (x + 0.0, y + 5.0), (x + 0.0, y - 5.0)]
        _box(pen, outline, colour, _shade(UNMET) if colour == UNMET else None, crossed=colour == MISSED)
        pen.text((x + 25, y), name, FAINT, _font(12), anchor="lm")
        x += 45 + round(pen.textlength(name, _font(12)))


def _background(extent: float) -> Image.Image:
    """Grid and axes."""
    image = Image.new("RGB", SIZE, GROUND)
    pen = ImageDraw.Draw(image)
    for value in np.linspace(-extent, extent, 5):
        across, down = (_pixels(np.array([value, value]), extent)).tolist()
        pen.line((LEFT + across, TOP, LEFT + across, TOP + SIDE), GRID)
        pen.line((LEFT, TOP + down, LEFT + SIDE, TOP + down), GRID)
        pen.text((LEFT + across, TOP + SIDE + 5), f"{value:.0f}", FAINT, _font(11), anchor="mt")
        pen.text((LEFT - 5, TOP + down), f"{value:.0f}", FAINT, _font(11), anchor="rm")
    pen.text(
        (LEFT + SIDE / 2, TOP + SIDE + 19), "x, east of the ego (m);  up: y, north (m)", FAINT, _font(11), anchor="mt"
    )
    return image


@lru_cache(maxsize=1)
def _palette() -> Image.Image:
    """Every colour that is drawn, and steps from the ground to each for the soft edges of text and for dim points."""
    bright = (INK, FAINT, WALL, MET, UNMET, MISSED, UNIT, *AGENTS)
    steps = [
        tuple(round(g + (c - g) * share) for g, c in zip(GROUND, colour, strict=True))
        for colour in bright
        for share in (1 / 4, 1 / 3, 1 / 2, 3 / 4)
    ]
    colours = dict.fromkeys([GROUND, GRID, *bright, *map(_shade, bright), *map(_dim, bright), *steps])
    image = Image.new("P", (1, 1))
    image.putpalette([value for colour in colours for value in colour])
    return image


def _font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size)
