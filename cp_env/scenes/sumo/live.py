"""Scenes without end, simulated by SUMO.

    open_source("sumo:urban?seed=3")
    open_source("sumo:/data/ingolstadt.sumocfg?density=0.8&share=0.3")
    open_source("sumo:/data/bologna.sumocfg?begin=28800")

Scenes are numbered, and number k is a function of (network, options, seed, k) alone: whatever process asks for it, in
whatever order, gets the same. A simulation begins and ends inside `load`, as libsumo holds one a process; processes do
not know of each other.
"""

from __future__ import annotations

import hashlib
import re
import tempfile
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, closing, contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from cp_env import lidar
from cp_env.scenes.errors import BrokenData
from cp_env.scenes.sumo import build, config, demand, selection, traffic
from cp_env.scenes.sumo.network import Streets, build_streets, draw_streets, read_network
from cp_env.scenes.sumo.places import focus, meetings, quarter
from cp_env.scenes.sumo.regimes import REGIMES
from cp_env.scenes.sumo.roadside import STYLES
from cp_env.scenes.sumo.traffic import Tracks
from cp_env.scenes.sumo.vehicle_sizes import draw_sizes
from cp_env.scenes.town import KINDS
from cp_env.types import Scene, Sweep

VERSION = 4
"""Part of the digest: rises when the same files give other scenes."""

SECONDS = 40.0  # s of traffic at a time, to choose the 20 s of a scene from
LONGEST = 900.0  # s: so long a configuration's demand drives on until enough vehicles meet
TRIES = 12  # simulations
STRICT = 3  # of them in which only moving vehicles are connected
EMPTY = 3  # simulations with too few cars after which no more are tried
SELECTIONS = 3  # tried at each place
JUMP = 14.0  # m in a frame, 250 km/h: what moves farther was moved by SUMO
PLACES = 3  # tried in each stretch of traffic
CROWD = 400  # vehicles: where more would drive through a bare network, they do so only round one place
_KEPT = 8  # scenes in memory
_BLOCK = 2**20  # bytes of a file read at a time


Found = tuple[build.Furnished, int, tuple[str, ...]]
"""What stands first in a `Draft`."""


@dataclass(frozen=True, eq=False)
class Draft:
    """A scene and the simulation that it was taken from, which can be run again while its files are there."""

    built: build.Furnished
    start: int  # first frame of the scene, counted from the beginning of its stretch
    connected: tuple[str, ...]  # SUMO's names, the ego first
    simulation: traffic.Simulation
    stretch: int  # number of the stretch that it lies in


class LiveSumo:
    """Any SUMO network, or streets drawn anew for every scene, as a `SceneSource` of numbered scenes.

    A scene has 100 frames at 5 Hz. Its world is turned at random and has its origin at the ego's path. Where traffic
    begins and ends inside a network, vehicles may appear and vanish; connected ones are there in every frame.

    Connected are vehicles that move. One that drives less than 10 m in the 20 s stands for the whole scene: it is
    chosen only where three simulations found no place with enough that move, and then only to make up the number asked
    for. Windows in which the connected wait less are preferred. The place, the ego and its partners are drawn from the
    seed and the number of the scene.

    The demand of a configuration drives in its busiest hour, unless `begin` names another: a simulation begins at a
    moment of that hour drawn at random, and goes on for up to 15 minutes, until enough vehicles meet. Trams, trains,
    ships, bicycles and people are left out, though they drive.

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
        begin: s of the simulation's clock, where the hour begins that scenes of a configuration are taken from. By
            default the hour, within the configuration's own period, in which the most cars depart: `vehicle`, `trip`
            and `flow` in its route and additional files are counted.

    Raises:
        BrokenData: a file is missing or no XML, or a network has no lane for cars.
        ImportError: SUMO is not installed.
        ValueError: an option out of range; or, by `load`, nothing drives, there is no place with enough connected
            vehicles, or SUMO refuses the network or the demand.
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
        begin: float | None = None,
    ) -> None:
        if density <= 0 or not 0 < share <= 1 or warm_up < 0:
            raise ValueError(
                f"density must be above 0, share in (0, 1], warm_up at least 0: got {density}, {share}, {warm_up}"
            )
        if begin is not None and not 0 <= begin < demand.LONGEST:
            raise ValueError(f"begin must be within 0 and 366 days, in seconds: got {begin}")
        if seed < 0 or scenes < 1 or vehicles < 2:
            raise ValueError(
                f"seed must be 0 or more, scenes 1 or more, vehicles 2 or more: got {seed}, {scenes}, {vehicles}"
            )
        if furnish not in STYLES:
            raise ValueError(f"furnish must be one of {', '.join(STYLES)}; got {furnish!r}")
        simulator = traffic.version()
        self._drawn = str(path) if str(path) in KINDS else None
        self._files = None if self._drawn else config.find(Path(path))
        if begin is not None and (self._files is None or self._files.config is None):
            raise ValueError(
                f"begin={begin:g} is for the demand of a configuration (.sumocfg); that of {path} is drawn anew"
            )
        self._polygons = polygons or (self._files.polygons if self._files else None)
        self._options = (seed, density, share, vehicles, furnish, warm_up, begin)
        self._seed, self._density, self._share, self._least, self._furnish, self._warm_up, self._begin = self._options
        self._stem = self._drawn or Path(path).name.split(".")[0]
        self.name = f"sumo/{self._stem}"
        self._names = tuple(f"{self._stem}-{k:06d}" for k in range(scenes))
        self.digest = self._digest(simulator)
        self._scenes: OrderedDict[int, Scene] = OrderedDict()

    def __getstate__(self) -> dict[str, Any]:
        heavy = ("_network", "_buildings")
        kept = {key: value for key, value in vars(self).items() if key not in heavy}
        return kept | {"_scenes": OrderedDict()}

    def _digest(self, simulator: str) -> str:
        sha = hashlib.sha256(repr((VERSION, self._stem, self._options, lidar.DIGEST, simulator)).encode())
        for file in (*(self._files.every if self._files else ()), *filter(None, [self._polygons])):
            try:
                with file.open("rb") as content:
                    while block := content.read(_BLOCK):
                        sha.update(block)
            except OSError as error:
                raise BrokenData(file, f"cannot be read: {error.strerror}") from error
        return sha.hexdigest()

    def names(self) -> tuple[str, ...]:
        """The first `scenes` numbers."""
        return self._names

    def load(self, name: str) -> Scene:
        """The scene of that number, simulated now unless it was among the last eight; a second or two.

        Raises:
            ValueError: no name of a scene, SUMO refuses, nothing drives, or there is no place with enough connected
                vehicles.
        """
        number = self._number(name)
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
        return read_network(self._files.net, np.inf)

    @cached_property
    def _departures(self) -> Float[np.ndarray, " M"]:
        assert self._files is not None
        until = self._files.end if np.isfinite(self._files.end) else self._files.begin + demand.DAY
        return demand.departures(self._files.demand, until)

    @cached_property
    def _period(self) -> demand.Period:
        """The hour that scenes are taken from."""
        assert self._files is not None
        if self._begin is not None:
            return demand.within(self._departures, self._begin)
        found = demand.busiest(self._departures, self._files.begin, self._files.end)
        return found or demand.Period(self._files.begin, 0.0, 0.0)

    @cached_property
    def _buildings(self) -> Float[np.ndarray, "B 6"] | None:
        return None if self._polygons is None else config.buildings(self._polygons)

    def _make(self, name: str, number: int) -> Scene:
        with self._drafted(name, number) as draft:
            return draft.built.scene

    def draft(self, name: str) -> AbstractContextManager[Draft]:
        """How the scene of that name was made, while the files of its simulation are there.

        Raises:
            ValueError: as of `load`.
        """
        return self._drafted(name, self._number(name))

    def _number(self, name: str) -> int:
        found = re.fullmatch(re.escape(self._stem) + r"-(\d{6,})", name)
        if not found:
            raise ValueError(f"unknown scene {name!r}; those of {self.name} are called {self._stem}- and six digits")
        return int(found[1])

    @contextmanager
    def _drafted(self, name: str, number: int) -> Iterator[Draft]:
        crowd, drove = 0, set[str]()
        for attempt in range(TRIES):
            rng = np.random.default_rng([self._seed, number, attempt])
            ways: tuple[selection.Standing, ...] = ("never",) if attempt < STRICT else ("never", "last")
            with tempfile.TemporaryDirectory() as folder:
                draft = None
                town, simulation = self._simulation(Path(folder), rng)
                with closing(simulation.stretches()) as stretches:
                    for stretch, tracks in enumerate(stretches):
                        crowd = max(crowd, int(np.isfinite(tracks.pose[..., 0]).sum(axis=1).max()))
                        drove |= tracks.left_out
                        for standing in ways:
                            found = self._place(name, town, tracks, rng, standing)
                            if found is not None:
                                draft = Draft(*found, simulation, stretch)
                                break
                        if draft is not None:
                            break
                if draft is not None:
                    yield draft
                    return
            if crowd < self._least and attempt + 1 >= EMPTY:
                raise ValueError(f"scene {name!r}: {self._too_few(crowd, drove)}")
        raise ValueError(
            f"scene {name!r}: in {TRIES} simulations no {self._least} connected vehicles stay within "
            f"{selection.RADIO:.0f} m of one of them for 20 s; raise density or share, or ask for fewer vehicles"
        )

    def _too_few(self, crowd: int, drove: set[str]) -> str:
        """How many cars drive at once, why, and the way out."""
        cars = (
            f"at most {crowd} cars drive at once, and {self._least} are to be connected" if crowd else "no car drives"
        )
        if self._files is None or self._files.config is None:
            return f"{cars}; raise density, or bring a configuration with a demand of its own"
        others = f" ({', '.join(sorted(drove))} drive, and are left out)" if drove else ""
        when = f"from {self._period.begin:g} s on {cars}{others}"
        best = demand.busiest(self._departures, self._files.begin, self._files.end)
        if best is None:
            return f"{when}, and the files of {self._files.config.name} send no car"
        other = f"begin={best.begin:g}, " if self._period.begin != best.begin else ""
        return (
            f"{when}; most cars of {self._files.config.name}, {best.departures:.0f}, depart in the hour from "
            f"{best.begin:g} s: take {other}a higher density, or fewer vehicles"
        )

    def _simulation(self, folder: Path, rng: np.random.Generator) -> tuple[Streets, traffic.Simulation]:
        """Streets and the traffic on them, drawn; its files are in `folder`."""
        if self._drawn:
            town = build_streets(*draw_streets(self._drawn, rng), folder)
            crowd = round(self._density * int(rng.integers(*REGIMES[self._drawn].crowd)))
            return town, traffic.prepare(town, folder, rng, crowd=crowd, warm_up=self._warm_up, seconds=SECONDS)
        assert self._files is not None
        network, most = self._network, SECONDS
        command = ["--seed", str(int(rng.integers(1 << 30)))]
        if self._files.config:
            most = LONGEST
            late = rng.uniform(0, max(0.0, self._period.span - self._warm_up - SECONDS))
            command += ["-c", str(self._files.config), "--scale", str(self._density)]
            command += ["--begin", f"{self._period.begin + late:.2f}", "--end", "-1"]
        else:
            if self._crowd(network) > CROWD:
                network = quarter(network, rng)
            crowd = self._crowd(network)
            sizes = draw_sizes(traffic.N_TYPES, rng, parked=False)
            routes = folder / "trips.rou.xml"
            config.write_demand(routes, network, sizes, rng, crowd, self._warm_up + SECONDS)
            command += ["-n", str(network.net), "-r", str(routes), "--max-num-vehicles", str(crowd)]
        warm_up = self._warm_up + rng.uniform(0, 30)
        return network, traffic.Simulation(
            command=tuple(command), warm_up=warm_up, seconds=SECONDS, most=most, jump=JUMP
        )

    def _crowd(self, network: Streets) -> int:
        return max(self._least, round(self._density * config.PER_KM * config.lane_kilometres(network)))

    def _place(
        self, name: str, town: Streets, tracks: Tracks, rng: np.random.Generator, standing: selection.Standing
    ) -> Found | None:
        """A scene somewhere in this stretch of traffic, if enough vehicles with a radio meet."""
        radio = rng.random(len(tracks.size)) < self._share
        if self._drawn:
            return self._build_scene(name, town, tracks, np.flatnonzero(radio), rng, standing)
        listening = tracks.of(radio)
        spots = meetings(listening, self._least, moving=standing == "never")
        spots = spots[np.linalg.norm(spots[:, :2] - town.centre, axis=1) <= town.radius]
        for spot in spots[rng.permutation(len(spots))[:PLACES]]:
            around, near = focus(town, tracks, spot)
            found = self._build_scene(name, around, tracks.of(near), np.flatnonzero(radio[near]), rng, standing)
            if found is not None:
                return found
        return None

    def _build_scene(
        self,
        name: str,
        town: Streets,
        tracks: Tracks,
        radios: Int[np.ndarray, " R"],
        rng: np.random.Generator,
        standing: selection.Standing,
    ) -> Found | None:
        kind = self._drawn or self._furnish
        buildings = np.zeros((0, 6)) if self._buildings is None and kind == "none" else self._buildings
        found = selection.candidates(tracks.of(radios), town, rng, SELECTIONS, least=self._least, standing=standing)
        for selected in found:
            chosen = replace(selected, connected=radios[selected.connected])
            built = build.furnish_scene(name, kind, town, tracks, chosen, rng, buildings)
            if built is not None:
                return built, chosen.start, tracks.of(chosen.connected).names
        return None
