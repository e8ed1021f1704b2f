"""Street networks drawn from a seed, built by netconvert: a town grid, a suburb of bent lanes, one large crossing."""

from __future__ import annotations

import subprocess
import xml.etree.ElementTree as ET
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import shapely
from jaxtyping import Float, Int
from shapely.geometry import LineString, Polygon

from cp_env.scenes.errors import BrokenData
from cp_env.scenes.sumo.xml_files import parse

STUB = 100.0  # m: the streets that lead out of a network, where traffic enters and leaves
LANE_WIDTH = 3.2  # m
SPEED = 8.33  # m/s: the limit; a 30 km/h zone

NO_CARS = frozenset({
    "pedestrian", "wheelchair", "bicycle", "scooter", "moped", "motorcycle", "tram", "rail_urban", "rail",
    "rail_electric", "rail_fast", "subway", "cable_car", "ship", "container", "drone", "aircraft",
})  # fmt: skip
"""SUMO's classes that are no road vehicle of four wheels or more."""

ROAD = frozenset({
    "passenger", "private", "emergency", "authority", "army", "vip", "hov", "taxi", "bus", "coach", "delivery", "truck",
    "trailer", "evehicle", "custom1", "custom2",
})  # fmt: skip
"""SUMO's classes of road vehicles of four wheels or more."""

RAILS = frozenset({"tram", "rail_urban", "rail", "rail_electric", "rail_fast"})
"""SUMO's classes whose tracks lie on the ground: nothing is built on them."""

NEEDS_SUMO = "new traffic needs SUMO; install this package with its extra: pip install '.[sumo]'"


@dataclass
class Plan:
    """A network before netconvert: nodes (x, y, type) and two-way streets between them."""

    nodes: dict[str, tuple[float, float, str]] = field(default_factory=dict)
    streets: list[tuple[str, str, int, list[tuple[float, float]]]] = field(default_factory=list)

    def node(self, name: str, x: float, y: float, kind: str) -> None:
        self.nodes[name] = (float(x), float(y), kind)

    def street(self, a: str, b: str, lanes: int, bend: float = 0.0) -> None:
        """A street from a to b with `lanes` each way, whose middle is pushed `bend` metres to its left."""
        p, q = (np.array(self.nodes[name][:2]) for name in (a, b))
        along = q - p
        left = np.array([-along[1], along[0]]) / np.hypot(*along)
        shape = (
            [tuple(p + t * along + 4 * t * (1 - t) * bend * left) for t in np.linspace(0, 1, 9)[1:-1]] if bend else []
        )
        self.streets.append((a, b, lanes, shape))


@dataclass(frozen=True)
class Lane:
    """One lane for road vehicles, of a street or of a junction."""

    edge: str
    index: int  # 0 is the outermost for them: the rightmost, or the leftmost where one drives on the left
    shape: Float[np.ndarray, "P 2"]
    width: float
    internal: bool  # inside a junction
    cars: bool = True  # whether cars may use it; others are for buses and the like


@dataclass(frozen=True)
class Streets:
    """A built network: where one drives, and where one enters and leaves."""

    net: Path
    lanes: list[Lane]
    carriageway: shapely.Geometry  # the union of lanes, rails and junctions
    junctions: Float[np.ndarray, "J 3"]  # x, y, 1 if signalised
    sources: list[str]
    sinks: list[str]
    centre: Float[np.ndarray, " 2"]
    radius: float  # m: the ego stays this near the centre, so that entering traffic does not pop up next to it
    lefthand: bool = False  # whether one drives on the left


def draw_streets(kind: str, rng: np.random.Generator) -> tuple[Plan, float]:
    """A plan, centred on the origin, and its useful radius.

    Args:
        kind: "urban", "suburban", "intersection" (one crossing with side streets) or "junction" (one crossing alone).
        rng: draws everything.
    """
    return {"urban": _urban, "suburban": _suburban, "intersection": _intersection, "junction": _junction}[kind](rng)


@dataclass(frozen=True)
class Grid:
    """A bent and thinned-out grid of streets."""

    spacing: tuple[float, float]  # m between crossings
    jitter: float  # m: spread of a crossing about its place
    bend: float  # m: spread of the middle of a street about its chord
    drop: float  # share of the streets left out
    signals: float  # share of crossings with traffic lights
    radius: float


SIDE = 4  # crossings along each side of a grid


def _urban(rng: np.random.Generator) -> tuple[Plan, float]:
    lanes = rng.choice([1, 1, 2], size=(2, SIDE))
    return _grid(rng, Grid(spacing=(46, 74), jitter=5, bend=0, drop=0.08, signals=0.5, radius=100), lanes)


def _suburban(rng: np.random.Generator) -> tuple[Plan, float]:
    lanes = np.ones((2, SIDE), dtype=int)
    return _grid(rng, Grid(spacing=(55, 85), jitter=10, bend=7, drop=0.22, signals=0.3, radius=110), lanes)


def _grid(rng: np.random.Generator, grid: Grid, lanes: Int[np.ndarray, "2 n"]) -> tuple[Plan, float]:
    """`lanes`: each way, of the streets west-east in row j and south-north in column i."""
    plan = Plan()
    xs, ys = (np.cumsum(rng.uniform(*grid.spacing, size=SIDE)) for _ in range(2))
    xs, ys = xs - xs.mean(), ys - ys.mean()
    for i, j in np.ndindex(SIDE, SIDE):
        kind = "traffic_light" if rng.random() < grid.signals else "priority"
        x, y = np.array([xs[i], ys[j]]) + rng.normal(0, grid.jitter, 2)
        plan.node(f"n{i}{j}", x, y, kind)
    for i, j in np.ndindex(SIDE, SIDE):
        for di, dj in ((1, 0), (0, 1)):
            if i + di < SIDE and j + dj < SIDE and rng.random() >= grid.drop:
                width = int(lanes[0, j] if di else lanes[1, i])
                bend = rng.normal(0, grid.bend) if grid.bend else 0.0
                plan.street(f"n{i}{j}", f"n{i + di}{j + dj}", width, bend)
    for i in range(SIDE):
        for name, at, step, width in (
            (f"s{i}", f"n{i}0", (0, -1), lanes[1, i]),
            (f"n_{i}", f"n{i}{SIDE - 1}", (0, 1), lanes[1, i]),
            (f"w{i}", f"n0{i}", (-1, 0), lanes[0, i]),
            (f"e{i}", f"n{SIDE - 1}{i}", (1, 0), lanes[0, i]),
        ):
            x, y, _ = plan.nodes[at]
            plan.node(name, x + STUB * step[0], y + STUB * step[1], "dead_end")
            plan.street(name, at, int(width))
    return plan, grid.radius


def _intersection(rng: np.random.Generator) -> tuple[Plan, float]:
    plan = Plan()
    plan.node("c", 0, 0, "traffic_light")
    arms = 3 if rng.random() < 0.25 else 4
    lanes = rng.choice([2, 3], size=2)
    for k in range(arms):
        angle = k * np.pi / 2 + rng.normal(0, 0.14)
        out = np.array([np.cos(angle), np.sin(angle)])
        near, far = rng.uniform(85, 115), rng.uniform(170, 190)
        plan.node(f"m{k}", near * out[0], near * out[1], "priority")
        plan.node(f"a{k}", far * out[0], far * out[1], "dead_end")
        plan.street(f"m{k}", "c", int(lanes[k % 2]), rng.normal(0, 3))
        plan.street(f"a{k}", f"m{k}", int(lanes[k % 2]))
        if rng.random() < 0.6:  # a side street
            side = angle + rng.choice([-1, 1]) * (np.pi / 2 + rng.normal(0, 0.15))
            x, y = near * out + 75 * np.array([np.cos(side), np.sin(side)])
            plan.node(f"b{k}", x, y, "dead_end")
            plan.street(f"b{k}", f"m{k}", 1)
    return plan, 85.0


def _junction(rng: np.random.Generator) -> tuple[Plan, float]:
    """Four wide arms, and nothing else."""
    plan = Plan()
    plan.node("c", 0, 0, "traffic_light")
    lanes = rng.choice([2, 3], size=2)
    for k in range(4):
        angle, far = k * np.pi / 2 + rng.normal(0, 0.14), rng.uniform(190, 210)
        plan.node(f"a{k}", far * np.cos(angle), far * np.sin(angle), "dead_end")
        plan.street(f"a{k}", "c", int(lanes[k % 2]), rng.normal(0, 3))
    return plan, 85.0


def build_streets(plan: Plan, radius: float, folder: Path) -> Streets:
    """Run netconvert on `plan`, leaving its files in `folder`."""
    nodes, edges = ET.Element("nodes"), ET.Element("edges")
    for name, (x, y, kind) in plan.nodes.items():
        ET.SubElement(nodes, "node", id=name, x=f"{x:.2f}", y=f"{y:.2f}", type=kind)
    for a, b, lanes, shape in plan.streets:
        ends = [plan.nodes[a][:2], plan.nodes[b][:2]]
        line = [ends[0], *shape, ends[1]]
        for tail, head, points in ((a, b, line), (b, a, line[::-1])):
            text = " ".join(f"{x:.2f},{y:.2f}" for x, y in points)
            attributes = {"id": f"{tail}-{head}", "from": tail, "to": head, "numLanes": str(lanes), "shape": text}
            ET.SubElement(edges, "edge", attributes, speed=str(SPEED), width=str(LANE_WIDTH))
    files = {name: folder / f"plan.{name}.xml" for name in ("nod", "edg", "net")}
    ET.ElementTree(nodes).write(files["nod"])
    ET.ElementTree(edges).write(files["edg"])
    command = [
        _tool("netconvert"), "-n", files["nod"], "-e", files["edg"], "-o", files["net"], "--no-turnarounds",
        "--tls.green.time", "20", "--tls.yellow.time", "3", "--tls.left-green.time", "5",
        "--junctions.corner-detail", "5", "--default.junctions.radius", "5",
        "--offset.disable-normalization", "--no-warnings",
    ]  # fmt: skip
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"netconvert failed: {done.stderr}")
    return read_network(files["net"], radius)


def read_network(net: Path, radius: float) -> Streets:
    """The streets of a network that road vehicles may use, centred on its origin.

    Args:
        net: a `.net.xml`; packed by gzip if its name ends in `.gz`.
        radius: m, of the part that is of use.

    Returns:
        The streets; `lefthand` as the network says.

    Raises:
        BrokenData: the file is missing or no XML, a lane or a junction is none, or no lane is for cars.
    """
    root = parse(net)
    lanes = [lane for edge in root.iter("edge") for lane in _lanes(net, edge)]
    if not any(lane.cars and not lane.internal for lane in lanes):
        raise BrokenData(net, f"has no lane for cars{_who_else(root)}")
    tracks = [lane for edge in root.iter("edge") for lane in _lanes(net, edge, RAILS)]
    areas = [LineString(lane.shape).buffer(lane.width / 2, cap_style="flat") for lane in (*lanes, *tracks)]
    spots = []
    for junction in root.iter("junction"):
        if junction.get("type") not in ("internal", "dead_end"):
            signal = junction.get("type", "").startswith("traffic_light")
            spots.append((*(_number(net, junction, key, 0.0) for key in "xy"), float(signal)))
        shape = _points(net, junction)
        if len(shape) > 2:
            areas.append(Polygon(shape).buffer(0))
    ends = {j.get("id") for j in root.iter("junction") if j.get("type") == "dead_end"}
    open_to_cars = {lane.edge for lane in lanes if lane.cars and not lane.internal}
    edges = [edge for edge in root.iter("edge") if edge.get("id") in open_to_cars]
    return Streets(
        net=net,
        lanes=lanes,
        carriageway=shapely.union_all(areas).buffer(0.1).buffer(-0.1),
        junctions=np.array(spots).reshape(-1, 3),
        sources=[edge.get("id", "") for edge in edges if edge.get("from") in ends],
        sinks=[edge.get("id", "") for edge in edges if edge.get("to") in ends],
        centre=np.zeros(2),
        radius=radius,
        lefthand=root.get("lefthand", "").strip().lower() in ("true", "1", "yes", "on", "x", "t"),
    )


def _lanes(net: Path, edge: ET.Element, classes: frozenset[str] = ROAD) -> list[Lane]:
    """Those for any of the classes, of a street or inside a junction; the outermost first."""
    if edge.get("function") not in (None, "normal", "internal"):  # connectors, crossings, walking areas
        return []
    lanes = []
    for index, lane in enumerate(lane for lane in edge.iter("lane") if _open_to(lane, classes)):
        shape, width = _points(net, lane), _number(net, lane, "width", LANE_WIDTH)
        if len(shape) < 2 or width <= 0:
            raise BrokenData(net, f"lane {lane.get('id')!r} has {len(shape)} points and is {width} m wide")
        internal, cars = edge.get("function") == "internal", _open_to(lane, frozenset({"passenger"}))
        lanes.append(Lane(edge.get("id", ""), index, shape, width, internal, cars))
    return lanes


def _who_else(root: ET.Element) -> str:
    """Whom the lanes of a network without cars are for, in words."""
    streets = [edge for edge in root.iter("edge") if edge.get("function") in (None, "normal")]
    allowed = {name for edge in streets for lane in edge.iter("lane") for name in lane.get("allow", "").split()}
    return f"; its lanes are for {', '.join(sorted(allowed))}" if allowed else ""


def _open_to(lane: ET.Element, classes: frozenset[str]) -> bool:
    """Whether one of the classes may use it."""
    if "allow" in lane.attrib:
        allowed = set(lane.attrib["allow"].split())
        return "all" in allowed or bool(classes & allowed)
    forbidden = set(lane.get("disallow", "").split())
    return "all" not in forbidden and bool(classes - forbidden)


def _points(net: Path, element: ET.Element) -> Float[np.ndarray, "P 2"]:
    text = element.get("shape", "").split()
    try:
        points = np.array([[float(v) for v in point.split(",")[:2]] for point in text]).reshape(len(text), 2)
    except ValueError as error:
        raise BrokenData(
            net, f"{element.tag} {element.get('id')!r}: its shape is no list of points: {error}"
        ) from error
    if not np.isfinite(points).all():
        raise BrokenData(net, f"{element.tag} {element.get('id')!r}: a point of its shape is not finite")
    return points


def _number(net: Path, element: ET.Element, key: str, default: float) -> float:
    try:
        number = float(element.get(key, default))
    except ValueError:
        number = np.nan
    if not np.isfinite(number):
        raise BrokenData(net, f"{element.tag} {element.get('id')!r}: {key}={element.get(key)!r} is no number")
    return number


def _tool(name: str) -> Path:
    """A program of the SUMO wheel.

    Raises:
        ImportError: SUMO is not installed; the message says how to get it.
    """
    try:
        import sumo
    except ImportError as error:
        raise ImportError(NEEDS_SUMO) from error
    return Path(sumo.SUMO_HOME) / "bin" / name
