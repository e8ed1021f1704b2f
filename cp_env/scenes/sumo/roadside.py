"""What stands along the streets: parked rows, house fronts, garden walls, hedges and trunks; and the road-side unit.

Convention:
    All boxes are in the network's frame. A kerb is walked along the outer edge of a street's outermost lane, with the
    traffic: the right edge, or the left one in a left-hand network. "out" is the distance from that edge away from the
    road. A left-hand network is furnished as the mirror image of a right-hand one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import shapely
from jaxtyping import Bool, Float
from shapely.geometry import LineString

from cp_env.geometry.planar import corners
from cp_env.scenes.sumo.network import Streets
from cp_env.scenes.sumo.vehicle_sizes import draw_sizes

STRIP = 2.3  # m: depth of a row of cars parked along the kerb
BAY = 5.4  # m: depth of a row of cars parked across it
PAVEMENT = 1.8  # m: free of buildings, along the road or the parked row
LONGEST_ACROSS = 6.2  # m: what is longer does not park across the kerb

Boxes = list[np.ndarray]  # rows x, y, yaw, length, width, height


@dataclass(frozen=True)
class Style:
    """How one kind of neighbourhood is furnished."""

    parked: float  # share of the kerb taken
    bays: float  # share of kerbs with cars parked across
    setback: tuple[float, float]  # m from pavement to house
    front: tuple[float, float]  # m of house along the street
    gap: tuple[float, float]  # m between houses
    height: tuple[float, float]
    fence: float  # share of gardens with a hedge or a wall
    trees: float  # a metre of kerb
    drives: float  # share of gates with a car in the drive behind


STYLES = {
    "urban": Style(0.86, 0.12, (0.2, 2.0), (9, 22), (0.0, 2.5), (8, 20), 0.15, 0.03, 0.1),
    "suburban": Style(0.62, 0.10, (2.5, 6.0), (9, 14), (3.0, 8.0), (4, 8), 0.80, 0.05, 0.7),
    "intersection": Style(0.82, 0.18, (0.5, 4.0), (12, 26), (0.5, 6.0), (6, 18), 0.30, 0.03, 0.1),
    "none": Style(0.0, 0.0, (0.5, 4.0), (12, 26), (0.5, 6.0), (6, 18), 0.0, 0.0, 0.0),  # between given buildings
}


@dataclass(frozen=True)
class Kerb:
    """One outer edge of a street between two junctions."""

    points: Float[np.ndarray, "P 2"]
    reached: Float[np.ndarray, " P"]  # m along the kerb at each point
    depth: float  # m: of the parked row
    across: bool
    side: int = 1  # 1 on the right of the traffic, -1 on its left

    @property
    def length(self) -> float:
        return float(self.reached[-1])

    def at(self, along: float, out: float) -> Float[np.ndarray, " 3"]:
        """The pose `along` metres from its start and `out` metres from the road, heading with the traffic."""
        tail, here, head = (self._point(along + step) for step in (-0.5, 0.0, 0.5))
        yaw = np.arctan2(head[1] - tail[1], head[0] - tail[0])
        away = self.side * out
        return np.array([here[0] + away * np.sin(yaw), here[1] - away * np.cos(yaw), yaw])

    def _point(self, along: float) -> Float[np.ndarray, " 2"]:
        """Beyond its ends the kerb goes straight on."""
        k = int(np.clip(np.searchsorted(self.reached, along) - 1, 0, len(self.points) - 2))
        share = (along - self.reached[k]) / (self.reached[k + 1] - self.reached[k])
        return self.points[k] + share * (self.points[k + 1] - self.points[k])


@dataclass(frozen=True)
class Layout:
    """What stands along the streets of a scene."""

    pose: Float[np.ndarray, "P 3"]  # parked vehicles
    size: Float[np.ndarray, "P 3"]
    obstacles: Float[np.ndarray, "B 6"]


def footprints(boxes: Float[np.ndarray, "B 6"]) -> np.ndarray:
    """Polygons of (x, y, yaw, length, width, ...) rows."""
    return shapely.polygons(corners(boxes[:, [0, 1, 3, 4, 2]]))


def furnish(
    streets: Streets,
    kind: str,
    path: Float[np.ndarray, "T 2"],
    swept: np.ndarray,
    rng: np.random.Generator,
    reach: float,
    buildings: Float[np.ndarray, "B 6"] | None = None,
) -> Layout:
    """Furnish what lies within `reach` m of the ego's `path`, but for the polygons that traffic has `swept`.

    Given `buildings` take the place of houses; those that stand where traffic drives are left out.
    """
    style = STYLES[kind]
    area = shapely.MultiPoint(path).buffer(reach)
    kerbs = _kerbs(streets, style, area, rng)
    wanted = _stack([box for kerb in kerbs for box in _parked(kerb, style, rng)])
    shapes = footprints(wanted)
    free = ~shapely.intersects(streets.carriageway, shapes) & shapely.contains(area, shapes)
    free &= ~_near(shapes, swept, 0.25)
    given = np.zeros((0, 6)) if buildings is None else buildings
    inside = shapely.intersects(area, footprints(given)) & ~_near(footprints(given), swept, 0.0)
    given = given[inside]
    free &= ~_near(shapes, footprints(given), 0.1)
    cars = wanted[_settle(shapes, free, 0.1)]
    obstacles = given
    makers: tuple[Callable[[Kerb, Style, np.random.Generator], Iterator[np.ndarray]], ...] = (_houses, _fences, _trunks)
    for make in makers if buildings is None else makers[1:]:
        wanted = _stack([box for kerb in kerbs for box in make(kerb, style, rng)])
        shapes = footprints(wanted)
        free = ~_near(shapes, np.concatenate([footprints(cars), swept]), 0.6) & ~_near(
            shapes, footprints(obstacles), 0.0
        )
        free &= ~shapely.dwithin(streets.carriageway, shapes, 1.2) & shapely.intersects(area, shapes)
        obstacles = np.concatenate([obstacles, wanted[_settle(shapes, free, 0.0)]])
    return Layout(cars[:, :3], cars[:, 3:], obstacles)


def _stack(boxes: Boxes) -> Float[np.ndarray, "B 6"]:
    return np.array(boxes).reshape(-1, 6)


def _near(shapes: np.ndarray, others: np.ndarray, distance: float) -> Bool[np.ndarray, " B"]:
    """Which of `shapes` lie within `distance` m of any of `others`."""
    hit = np.zeros(len(shapes), dtype=bool)
    hit[shapely.STRtree(others).query(shapes, predicate="dwithin", distance=distance)[0]] = True
    return hit


def _settle(shapes: np.ndarray, free: Bool[np.ndarray, " B"], distance: float) -> list[int]:
    """Rows that may stay: free, and farther than `distance` m from every earlier row that stays."""
    neighbours: dict[int, list[int]] = {}
    pairs = shapely.STRtree(shapes).query(shapes, predicate="dwithin", distance=distance)
    for a, b in pairs.T.tolist():
        neighbours.setdefault(a, []).append(b)
    stays = np.zeros(len(shapes), dtype=bool)
    for k in np.flatnonzero(free).tolist():
        stays[k] = not stays[neighbours[k]].any()
    return [int(k) for k in np.flatnonzero(stays)]


def _kerbs(streets: Streets, style: Style, area: shapely.Geometry, rng: np.random.Generator) -> list[Kerb]:
    kerbs = []
    side = -1 if streets.lefthand else 1
    for lane in streets.lanes:
        across = bool(rng.random() < style.bays)
        if lane.internal or lane.index or not area.intersects(LineString(lane.shape)):
            continue
        line = LineString(lane.shape).offset_curve(-side * lane.width / 2)
        if line.length > 12 and line.geom_type == "LineString":
            points = shapely.get_coordinates(line)
            reached = np.concatenate([[0.0], np.linalg.norm(np.diff(points, axis=0), axis=1).cumsum()])
            kerbs.append(Kerb(points, reached, BAY if across else STRIP, across, side))
    return kerbs


def _parked(kerb: Kerb, style: Style, rng: np.random.Generator) -> Iterator[np.ndarray]:
    """Cars along the kerb or across it, with gaps; a gap may be a gate with a car in the drive behind."""
    sizes = draw_sizes(int(kerb.length / 2) + 1, rng, parked=True)
    along = rng.uniform(3, 7)
    for length, width, height in sizes:
        if along > kerb.length - 6:
            return
        if kerb.across and length > LONGEST_ACROSS:
            continue
        taken = rng.random() < style.parked
        gate = 0.0 if taken or rng.random() > 0.4 else rng.uniform(3.4, 5.5)
        room = width + rng.uniform(0.6, 1.0) if kerb.across else length + rng.uniform(0.5, 1.4)
        pose = None
        if taken:
            turn = rng.choice([-1, 1]) * np.pi / 2 if kerb.across else 0.0
            half = (length if kerb.across else width) / 2
            out = half + 0.35 + rng.normal(0, 0.07)
            pose = kerb.at(along + room / 2, out)
            pose[2] += kerb.side * (turn + rng.normal(0, 0.02))
        elif gate and length < LONGEST_ACROSS and rng.random() < style.drives:
            out = kerb.depth + PAVEMENT + length / 2 + rng.uniform(0.3, 2.0)
            pose = kerb.at(along + gate / 2, out)
            pose[2] += kerb.side * (np.pi / 2 + rng.normal(0, 0.03))
        along += gate or room
        if pose is not None:
            yield np.array([*pose, length, width, height])


def _houses(kerb: Kerb, style: Style, rng: np.random.Generator) -> Iterator[np.ndarray]:
    along = rng.uniform(-8, 0)  # house corners stand at the junction
    while along < kerb.length:
        front, depth, height = rng.uniform(*style.front), rng.uniform(8, 13), rng.uniform(*style.height)
        out = kerb.depth + PAVEMENT + rng.uniform(*style.setback)
        for wide, deep in ((1.0, 1.0), (1.0, 0.55), (0.6, 0.8), (0.5, 0.45)):  # the first that has room stays
            yield np.array(
                [*kerb.at(along + front * wide / 2, out + depth * deep / 2), front * wide, depth * deep, height]
            )
        along += front + rng.uniform(*style.gap)


def _fences(kerb: Kerb, style: Style, rng: np.random.Generator) -> Iterator[np.ndarray]:
    along = 0.0
    while along < kerb.length:
        length = rng.uniform(5, 12)
        if rng.random() < style.fence:
            thick, height = (0.25, rng.uniform(1.0, 1.9)) if rng.random() < 0.4 else (0.8, rng.uniform(1.2, 2.2))
            pose = kerb.at(along + length / 2, kerb.depth + PAVEMENT - 0.2 + thick / 2)
            yield np.array([*pose, length, thick, height])
        along += length + rng.choice([0.0, 1.2, 3.5])


def _trunks(kerb: Kerb, style: Style, rng: np.random.Generator) -> Iterator[np.ndarray]:
    for along in rng.uniform(0, kerb.length, rng.poisson(style.trees * kerb.length)):
        thick = rng.choice([0.15, 0.3, 0.45, 0.6])
        yield np.array([*kerb.at(along, kerb.depth + 0.7 + thick / 2), thick, thick, rng.uniform(4, 7)])


def place_rsu(
    streets: Streets, layout: Layout, path: Float[np.ndarray, "T 2"], rng: np.random.Generator
) -> Float[np.ndarray, " 3"] | None:
    """A pole at the corner of the junction nearest to the ego's path (a signalised one if it is about as near).

    Returns:
        x, y, z of its top, m; None where everything round the junction is built over.
    """
    distance = np.linalg.norm(path[:, None] - streets.junctions[None, :, :2], axis=-1).mean(axis=0)
    spot = streets.junctions[np.argmin(distance - 10 * streets.junctions[:, 2]), :2]
    ring = shapely.get_coordinates(shapely.segmentize(streets.carriageway.buffer(1.0).boundary, 1.0))
    ring = ring[np.argsort(np.linalg.norm(ring - spot, axis=1))[:400]]
    solid = np.concatenate([footprints(np.column_stack([layout.pose, layout.size])), footprints(layout.obstacles)])
    clear = ~_near(shapely.points(ring), solid, 0.3)
    return np.array([*ring[clear][0], rng.uniform(5.6, 6.6)]) if clear.any() else None
