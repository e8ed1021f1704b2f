"""V2X-Sim 2.0 as it is distributed: tables in the nuScenes format and one file a LiDAR sweep.

Source: Li et al., "V2X-Sim", RA-L 2022; the format is that of nuScenes (Caesar et al., CVPR 2020).

Convention:
    world    the tables' global frame: right-handed, x and y level, z up; m. We call its x axis east.
    sensor   a LiDAR's own frame, in which its file stores points; `world_T_sensor = world_T_ego · ego_T_sensor`.
    box      centre, (width, length, height), quaternion in the tables; the heading is the turned x axis, seen from
             above. A vehicle may pitch and roll: its returns are counted, and its own left out, along its box's axes.
    ground   under a sensor: the foot of its carrier's box; under a road-side unit, and everywhere else: the road that
             the feet of the frame's boxes make (`cp_env.scenes.assembly.road`).
    Points go through the whole chain in three dimensions, and x and y are taken at its end: no map is tilted, and none
    has to be warped for it. On a hill z is height above the road under the point.
    A sweep is given from the middle of its carrier's box, at the sensor's height: that is the place a vehicle shares.
    Returns from the carrier itself are left out.
"""

from __future__ import annotations

from pathlib import Path

from cp_env.scenes.v2xsim.indexing import open_index
from cp_env.scenes.v2xsim.splits import choose
from cp_env.scenes.v2xsim.tabled import Tabled
from cp_env.scenes.v2xsim.tables import find_tables

CATEGORIES = ("vehicle.car", "vehicle.emergency", "vehicle.van", "vehicle.truck", "vehicle.bus", "vehicle.trailer")


class V2XSim(Tabled):
    """Scenes of a V2X-Sim 2.0 folder (a `SceneSource`); connected are the vehicles with a sweep in every frame.

    Args:
        path: the folder that holds `sweeps` and the folder of tables.
        split: "train", "val", "test" (the official ones) or "all".
        scenes: only these, by name or number.
        vehicles: leave out scenes with fewer connected vehicles.
        categories: what counts as a vehicle, by the beginning of its category's name. coperception's ground truth is
            "vehicle.car,vehicle.emergency.police". Vehicles that carry a sensor always count.
        rsu: whether scenes show their road-side unit.
        version: the folder of tables, if there are several.
        skip_broken: leave broken scenes out, and list them in `left_out`, instead of raising.
        progress: show a bar while the tables are indexed.

    Raises:
        BrokenData: a missing, cut short or contradictory file, with its name and the reason.
        ValueError: no such split or scene, or none left.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        split: str = "all",
        scenes: tuple[str, ...] = (),
        vehicles: int = 1,
        categories: tuple[str, ...] = CATEGORIES,
        rsu: bool = True,
        version: str | None = None,
        skip_broken: bool = False,
        progress: bool = True,
    ) -> None:
        root = Path(path)
        index = open_index(find_tables(root, version), progress=progress)
        names = [entry.name for entry in index.entries]
        place = {names[k]: k for k in choose(names, split, scenes)}
        super().__init__(
            f"v2x-sim/{split}",
            root,
            index,
            place,
            vehicles=vehicles,
            categories=categories,
            rsu=rsu,
            skip_broken=skip_broken,
        )
