"""What a SUMO configuration names, the buildings of a polygon file, and demand for a network that has none.

Convention: as in SUMO, x east, y north; m.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import shapely
from jaxtyping import Float
from shapely.geometry import Polygon

from cp_env.scenes.errors import BrokenData
from cp_env.scenes.sumo.demand import seconds
from cp_env.scenes.sumo.network import Streets
from cp_env.scenes.sumo.traffic import write_types
from cp_env.scenes.sumo.xml_files import parse

PER_KM = 15.0
"""Vehicles on a kilometre of lane at density 1."""

HEIGHT, LEVEL = 9.0, 3.0  # m: of a building that says nothing, and of a storey
WALL = 0.3  # m
_SQUARE = 0.97  # of its bounding rectangle a building fills, to be drawn as one box
_DETAIL = 0.3  # m: smaller corners are smoothed away


@dataclass(frozen=True)
class Files:
    """What a simulation is made of; `config` is None where our own demand drives through a bare network."""

    config: Path | None
    net: Path
    polygons: Path | None
    every: tuple[Path, ...]  # that the simulation reads
    demand: tuple[Path, ...] = ()  # additional files, then route files: where vehicle types and vehicles stand
    begin: float = 0.0  # s, of the configuration's own period
    end: float = np.inf  # s


def find(path: Path) -> Files:
    """The files that a `.sumocfg` or a `.net.xml` stands for; all but the configuration may be packed (`.gz`).

    Old configurations have a root of any name, such as `<c>`: SUMO reads them, so their `net-file` is what counts.
    Polygons are the configuration's additional file called `*.poly.xml`, or `NAME.poly.xml` next to `NAME.net.xml`.

    Raises:
        BrokenData: a file is missing or no XML, the configuration is packed, names no network, or its period is none.
    """
    root = parse(path)
    if root.tag == "net":
        candidates = [path.with_name(f"{path.name.split('.')[0]}.poly.xml{packed}") for packed in ("", ".gz")]
        polygons = next((file for file in candidates if file.exists()), None)
        return Files(None, path, polygons, (path, *filter(None, [polygons])))
    if root.tag not in ("configuration", "sumoConfiguration") and root.find(".//net-file") is None:
        raise BrokenData(path, f"is neither a network nor a configuration of SUMO but a <{root.tag}>")
    if path.suffix == ".gz":
        raise BrokenData(path, "is a packed configuration, which SUMO does not read: unpack it with gunzip")
    named = {
        key: [path.parent / name.strip() for name in _value(root, key).split(",") if name.strip()] for key in _KEYS
    }
    if not named["net-file"]:
        raise BrokenData(path, "names no net-file")
    every = (path, *(file for files in named.values() for file in files))
    for file in every:
        if not file.exists():
            raise BrokenData(file, f"is missing; {path.name} names it")
    polygons = next((file for file in named["additional-files"] if ".poly.xml" in file.name), None)
    try:
        begin, end = seconds(_value(root, "begin") or "0"), seconds(_value(root, "end") or "-1")
    except ValueError as error:
        raise BrokenData(path, f"begin or end: {error}") from error
    demand = (*(file for file in named["additional-files"] if file != polygons), *named["route-files"])
    return Files(path, named["net-file"][0], polygons, every, demand, begin, end if end >= 0 else np.inf)


_KEYS = ("net-file", "route-files", "additional-files")


def _value(root: ET.Element, key: str) -> str:
    element = root.find(f".//{key}")
    return "" if element is None else element.get("value", element.get("v", ""))


def buildings(path: Path) -> Float[np.ndarray, "B 6"]:
    """Boxes (x, y, yaw, length, width, height) of all polygons whose type begins with "building".

    A building that is nearly a rectangle is one box, another its outer walls: from the street they look the same. Its
    height is its parameter `height`, or 3 m for each of its `building:levels`, or 9 m.

    Raises:
        BrokenData: the file is missing or no XML, or a polygon has no shape.
    """
    boxes: list[list[float]] = []
    for poly in parse(path).iter("poly"):
        if not poly.get("type", "").startswith("building"):
            continue
        said = {param.get("key", ""): param.get("value", "") for param in poly.iter("param")}
        try:
            corners = [[float(v) for v in point.split(",")[:2]] for point in poly.get("shape", "").split()]
            area = Polygon(corners).buffer(0).simplify(_DETAIL)
            height = float(said.get("height", 0)) or LEVEL * float(said.get("building:levels", 0)) or HEIGHT
        except (ValueError, IndexError) as error:
            raise BrokenData(path, f"polygon {poly.get('id')!r}: {error}") from error
        for part in shapely.get_parts(area):
            boxes += [[*box, height] for box in _boxes(part)]
    return np.array(boxes).reshape(-1, 6)


def _boxes(area: Polygon) -> list[list[float]]:
    """x, y, yaw, length, width of the rectangle round `area` if it fills that, else of each of its walls."""
    if area.is_empty or area.area < 1:
        return []
    whole = shapely.get_coordinates(shapely.oriented_envelope(area))
    if area.area >= _SQUARE * Polygon(whole).area:
        return [_along(whole[0], whole[1], float(np.linalg.norm(whole[2] - whole[1])), *(whole[:4].mean(axis=0)))]
    ring = shapely.get_coordinates(area.exterior)
    return [_along(a, b, WALL, *((a + b) / 2)) for a, b in pairwise(ring)]


def _along(a: Float[np.ndarray, " 2"], b: Float[np.ndarray, " 2"], width: float, x: float, y: float) -> list[float]:
    return [float(x), float(y), float(np.arctan2(*(b - a)[::-1])), float(np.linalg.norm(b - a)), width]


def write_demand(
    path: Path, streets: Streets, sizes: Float[np.ndarray, "K 3"], rng: np.random.Generator, crowd: int, horizon: float
) -> None:
    """Trips for a bare network: `crowd` vehicles anywhere at the start, then as many enter as fit, for `horizon` s.

    They enter and leave at dead ends where the network has some, else anywhere.
    """
    lanes = [lane for lane in streets.lanes if lane.cars and not lane.internal]
    length = np.array([np.linalg.norm(np.diff(lane.shape, axis=0), axis=1).sum() for lane in lanes])
    edges = [lane.edge for lane in lanes]
    enter, leave = streets.sources or edges, streets.sinks or edges
    root = ET.Element("routes")
    write_types(root, sizes, rng)
    starts = [edges[k] for k in rng.choice(len(edges), size=crowd, p=length / length.sum())]
    later = np.arange(1.0, horizon, horizon / max(crowd, horizon))
    for k, depart in enumerate([*np.zeros(crowd), *later]):
        source = starts[k] if k < crowd else enter[rng.integers(len(enter))]
        trip = {
            "id": f"v{k}",
            "from": source,
            "to": leave[rng.integers(len(leave))],
            "type": str(rng.integers(len(sizes))),
        }
        start = {"depart": f"{depart:.2f}", "departLane": "best", "departSpeed": "max"}
        ET.SubElement(root, "trip", trip, departPos="random_free" if k < crowd else "base", **start)
    ET.ElementTree(root).write(path)


def lane_kilometres(streets: Streets) -> float:
    """Length of all lanes for cars, junctions left out; km."""
    lanes = [lane.shape for lane in streets.lanes if lane.cars and not lane.internal]
    return float(sum(np.linalg.norm(np.diff(shape, axis=0), axis=1).sum() for shape in lanes)) / 1000
