"""Scenes without end, simulated by SUMO.

    open_source("sumo:urban?seed=3")
    open_source("sumo:/data/ingolstadt.sumocfg?density=0.8&share=0.3")

Scenes are numbered, and number k is a function of (network, options, seed, k) alone: whatever process asks for it, in
whatever order, gets the same. A simulation begins and ends inside `load`, as libsumo holds one a process; processes do
not know of each other.
"""

from __future__ import annotations

import hashlib
import re
import tempfile
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from jaxtyping import Float

from cp_env import lidar
from cp_env.scenes.errors import BrokenData
from cp_env.scenes.sumo import build, config, selection, traffic
from cp_env.scenes.sumo.network import Streets, build_streets, draw_streets, read_network
from cp_env.scenes.sumo.roadside import STYLES
from cp_env.scenes.sumo.traffic import Tracks
from cp_env.scenes.sumo.vehicle_sizes import draw_sizes
from cp_env.scenes.town import KINDS
from cp_env.types import Scene, Sweep

VERSION = 2
"""Part of the digest: rises when the same files give other scenes."""

SECONDS = 40.0  # s kept of each simulation, to choose the 20 s of a scene from
TRIES = 12
SELECTIONS = 3  # tried at each place
JUMP = 14.0  # m in a frame, 250 km/h: what moves farther was moved by SUMO
AROUND = 270.0  # m: of a large network only what is so near to the place of the scene is used
PLACES = 3  # tried in each simulation
CROWD = 400  # vehicles: where more would drive through a bare network, they do so only round one place
DRIVEN = 420.0  # m: so far from it
_KEPT = 8  # scenes in memory


class LiveSumo:
    """Any SUMO network, or streets drawn anew for every scene, as a `SceneSource` of numbered scenes.

    A scene has 100 frames at 5 Hz. Its world is turned at random and has its origin at the ego's path. Where traffic
    begins and ends inside a network, vehicles may appear and vanish; connected ones are there in every frame.

    Args:
        path: a `.sumocfg` (its own demand drives), a `.net.xml` (demand is drawn: see `density`), or one of "urban",
            "suburban" and "intersection": every scene then has streets of its own. Files may be packed (`.gz`).
        seed: of everything.
        scenes: how many names `names` gives; `load` takes any number. More than an agent ever plays is no harm.
        density: of traffic. A factor on the demand of a configuration (SUMO's `--scale`), on 15 vehicles for each
            kilometre of lane of a bare network, on the shipped scenes' crowd for drawn streets.
        share: of the moving vehicles that have a radio, and so may be connected.
        vehicles: every scene has at least so many connected vehicles; at most 8, or `vehicles` if that is more.
        furnish: what stands along the streets: "urban", "suburban", "intersection" (parked cars, houses, fences,
            trunks) or "none". Drawn streets have their own.
        polygons: file of the buildings, which then take the place of houses; by default the one that the configuration
            names, or that lies next to the network.
        warm_up: s simulated before anything is recorded.

    Raises:
        BrokenData: a file is missing or no XML.
        ImportError: SUMO is not installed.
        ValueError: an option out of range; or, by `load`, no place with enough connected vehicles, or a network or
            demand that SUMO refuses.
    """

    endless = True

    def __init__(
        self,
        path: str | Path,
        *,
        seed: int = 0,
        scenes: int = 10_000,
        density: float = 1.0,
        share: float = 1.0,
        vehicles: int = selection.LEAST,
        furnish: str = "urban",
        polygons: Path | None = None,
        warm_up: float = 60.0,
    ) -> None:
        if density <= 0 or not 0 < share <= 1 or warm_up < 0:
            raise ValueError(
                f"density must be above 0, share in (0, 1], warm_up at least 0: got {density}, {share}, {warm_up}"
            )
        if seed < 0 or scenes < 1 or vehicles < 2:
            raise ValueError(
                f"seed must be 0 or more, scenes 1 or more, vehicles 2 or more: got {seed}, {scenes}, {vehicles}"
            )
        if furnish not in STYLES:
            raise ValueError(f"furnish must be one of {', '.join(STYLES)}; got {furnish!r}")
        simulator = traffic.version()
        self._drawn = str(path) if str(path) in KINDS else None
        self._files = None if self._drawn else config.find(Path(path))
        self._polygons = polygons or (self._files.polygons if self._files else None)
        self._options = (seed, density, share, vehicles, furnish, warm_up)
        self._seed, self._density, self._share, self._least, self._furnish, self._warm_up = self._options
        self._stem = self._drawn or Path(path).name.split(".")[0]
        self.name = f"sumo/{self._stem}"
        self._names = tuple(f"{self._stem}-{k:06d}" for k in range(scenes))
        self.digest = self._digest(simulator)
        self._scenes: OrderedDict[int, Scene] = OrderedDict()

    def __getstate__(self) -> dict[str, Any]:
        return {key: value for key, value in vars(self).items() if key not in ("_network", "_buildings")} | {
            "_scenes": OrderedDict()
        }

    def _digest(self, simulator: str) -> str:
        sha = hashlib.sha256(repr((VERSION, self._stem, self._options, lidar.DIGEST, simulator)).encode())
        for file in (*(self._files.every if self._files else ()), *filter(None, [self._polygons])):
            try:
                sha.update(file.read_bytes())
            except OSError as error:
                raise BrokenData(file, f"cannot be read: {error.strerror}") from error
        return sha.hexdigest()

    def names(self) -> tuple[str, ...]:
        """The first `scenes` numbers."""
        return self._names

    def load(self, name: str) -> Scene:
        """The scene of that number, simulated now unless it was among the last eight; a second or two.

        Raises:
            ValueError: no name of a scene, SUMO refuses, or there is no place with enough connected vehicles.
        """
        found = re.fullmatch(re.escape(self._stem) + r"-(\d{6,})", name)
        if not found:
            raise ValueError(f"unknown scene {name!r}; those of {self.name} are called {self._stem}- and six digits")
        number = int(found[1])
        if number not in self._scenes:
            self._scenes[number] = self._make(name, number)
        self._scenes.move_to_end(number)
        while len(self._scenes) > _KEPT:
            self._scenes.popitem(last=False)
        return self._scenes[number]

    def sweeps(self, scene: Scene, frames: Sequence[int]) -> list[list[Sweep]]:
        """`[frame][agent]`: the connected vehicles in order, then the road-side unit where there is a junction."""
        return lidar.scan([(scene, int(frame)) for frame in frames])

    @cached_property
    def _network(self) -> Streets:
        assert self._files is not None
        network = read_network(self._files.net, np.inf)
        if not any(not lane.internal for lane in network.lanes):
            raise BrokenData(self._files.net, "has no lane for cars")
        return network

    @cached_property
    def _buildings(self) -> Float[np.ndarray, "B 6"] | None:
        return None if self._polygons is None else config.buildings(self._polygons)

    def _make(self, name: str, number: int) -> Scene:
        for attempt in range(TRIES):
            rng = np.random.default_rng([self._seed, number, attempt])
            with tempfile.TemporaryDirectory() as folder:
                town, tracks = self._drive(Path(folder), rng)
            for _ in range(1 if self._drawn else PLACES):
                place = (town, tracks) if self._drawn else self._focus(town, tracks, rng)
                scene = self._build_scene(name, *place, rng)
                if scene is not None:
                    return scene
        raise ValueError(
            f"scene {name!r}: in {TRIES} simulations no {self._least} connected vehicles stay within "
            f"{selection.RADIO:.0f} m of one of them for 20 s; raise density or share, or ask for fewer vehicles"
        )

    def _drive(self, folder: Path, rng: np.random.Generator) -> tuple[Streets, Tracks]:
        if self._drawn:
            town = build_streets(*draw_streets(self._drawn, rng), folder)
            crowd = round(self._density * int(rng.integers(*build.CROWD[self._drawn])))
            return town, traffic.drive(town, folder, rng, crowd=crowd, warm_up=self._warm_up, seconds=SECONDS)
        assert self._files is not None
        network = self._network
        command = ["--seed", str(int(rng.integers(1 << 30)))]
        if self._files.config:
            command += ["-c", str(self._files.config), "--scale", str(self._density)]
        else:
            if self._crowd(network) > CROWD:
                network = _quarter(network, rng)
            crowd = self._crowd(network)
            sizes = draw_sizes(traffic.N_TYPES, rng, parked=False)
            routes = folder / "trips.rou.xml"
            config.write_demand(routes, network, sizes, rng, crowd, self._warm_up + SECONDS)
            command += ["-n", str(network.net), "-r", str(routes), "--max-num-vehicles", str(crowd)]
        warm_up = self._warm_up + rng.uniform(0, 30)
        return network, traffic.watch(command, warm_up=warm_up, seconds=SECONDS, jump=JUMP)

    def _crowd(self, network: Streets) -> int:
        return max(self._least, round(self._density * config.PER_KM * config.lane_kilometres(network)))

    def _focus(self, network: Streets, tracks: Tracks, rng: np.random.Generator) -> tuple[Streets, Tracks]:
        """What lies round one vehicle, drawn at random: a city is too much to search for a scene."""
        spots = tracks.pose[::25, :, :2][np.isfinite(tracks.pose[::25, :, 0])]
        spots = spots[np.linalg.norm(spots - network.centre, axis=1) <= network.radius]
        if not len(spots):
            return network, tracks
        centre = spots[rng.integers(len(spots))]
        far = np.linalg.norm(tracks.pose[..., :2] - centre, axis=-1)
        near = np.flatnonzero((far < AROUND).any(axis=0))
        box = (*(centre - AROUND), *(centre + AROUND))
        lanes = [lane for lane in network.lanes if (np.abs(lane.shape - centre) < AROUND).all(axis=1).any()]
        junctions = network.junctions[(np.abs(network.junctions[:, :2] - centre) < AROUND).all(axis=1)]
        carriageway = shapely.clip_by_rect(network.carriageway, *box)
        radius = AROUND - build.REACH - 10
        town = replace(network, lanes=lanes, junctions=junctions, carriageway=carriageway, centre=centre, radius=radius)
        return town, Tracks(tracks.pose[:, near], tracks.size[near])

    def _build_scene(self, name: str, town: Streets, tracks: Tracks, rng: np.random.Generator) -> Scene | None:
        radios = np.flatnonzero(rng.random(len(tracks.size)) < self._share)
        listening = Tracks(tracks.pose[:, radios], tracks.size[radios])
        kind = self._drawn or self._furnish
        buildings = np.zeros((0, 6)) if self._buildings is None and kind == "none" else self._buildings
        for selected in selection.candidates(listening, town, rng, SELECTIONS, least=self._least):
            chosen = replace(selected, connected=radios[selected.connected])
            scene = build.build_scene(name, kind, town, tracks, chosen, rng, buildings)
            if scene is not None:
                return scene
        return None


def _quarter(network: Streets, rng: np.random.Generator) -> Streets:
    """What lies within `DRIVEN` of a street drawn at random: vehicles farther off are never seen by a scene there."""
    streets = [lane for lane in network.lanes if not lane.internal]
    length = np.array([np.linalg.norm(np.diff(lane.shape, axis=0), axis=1).sum() for lane in streets])
    centre = streets[rng.choice(len(streets), p=length / length.sum())].shape.mean(axis=0)
    lanes = [lane for lane in network.lanes if (np.linalg.norm(lane.shape - centre, axis=1) < DRIVEN).all()]
    edges = {lane.edge for lane in lanes if not lane.internal}
    sources, sinks = ([edge for edge in ends if edge in edges] for ends in (network.sources, network.sinks))
    radius = DRIVEN - AROUND
    return replace(network, lanes=lanes, sources=sources, sinks=sinks, centre=centre, radius=radius)
