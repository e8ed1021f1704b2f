"""OPV2V and V2XSet: recorded drives in CARLA, as scenes.

    open_source("opv2v:/data/OPV2V?split=test&vehicles=5")

Convention: the files are left-handed and in degrees, see `axes`; what comes out is ours, see `cp_env.types`. The road
is taken to be flat and level round each sensor, at the height of the origin of the vehicle next to it.
"""

from __future__ import annotations

from pathlib import Path

from cp_env.scenes.opv2v.classes import DEFAULT
from cp_env.scenes.opv2v.layouts import OPV2V as LAYOUT
from cp_env.scenes.opv2v.recorded import Options, Recorded


class OPV2V(Recorded):
    """One split of OPV2V or V2XSet, or any data in their layout (a `SceneSource`).

    Agents keep OpenCOOD's order: names sorted as text, the first is the ego; a road-side unit (V2XSet) is the last. A
    scene's vehicles are its agents, then all others ever listed by any of them, by number. A box stands where its
    `center` puts it along the vehicle's own axes (OpenCOOD adds `center` along the world's; it is centimetres).
    Returns from the vehicle that carries the sensor are left out, as in the town.

    Args:
        path: the data set's folder, or the folder of one split.
        split: name of the folder inside it, such as "train", "validate", "test" or "test_culver_city".
        scenes: names of scenarios, or of pieces of them; all by default.
        vehicles: leave out scenarios with fewer.
        stride: every so many files are a frame; by default what comes nearest to `RATE`: 2, as files are 10 Hz.
        tick: seconds from one file number to the next; by default what numbers, timestamps and speeds say together:
            0.05, CARLA's step, of which OPV2V and V2XSet number every second one.
        rsu: whether scenes show their road-side unit.
        poses: "true", or "predicted": others stand where their and the ego's recorded localisation put them.
        noise: deviations of the place (m) and the heading (degrees) at which the ego takes others to be, drawn anew
            for each agent and frame. Positions in `Scene` stay true; the points of others' sweeps are displaced.
        seed: of the noise.
        classes: what counts as a vehicle: groups and types of `classes.CLASSES`, a leading "-" leaves a type out. It is
            held against an object's `obj_type`; one without it is a vehicle.
        skip_broken: read everything first, and leave the frames out that a broken file touches; `left_out` says which.

    Raises:
        BrokenData: the folder or a file is missing, or, when they are read, broken: the file and the reason are named.
        ValueError: an option out of range, unknown scenes, or no scenario with enough vehicles.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        split: str = "",
        scenes: tuple[str, ...] = (),
        vehicles: int = 1,
        stride: int | None = None,
        tick: float | None = None,
        rsu: bool = True,
        poses: str = "true",
        noise: tuple[float, ...] = (0.0, 0.0),
        seed: int = 0,
        classes: tuple[str, ...] = DEFAULT,
        skip_broken: bool = False,
    ) -> None:
        options = Options(
            scenes=scenes,
            vehicles=vehicles,
            stride=stride,
            tick=tick,
            rsu=rsu,
            poses=poses,
            noise=noise,
            seed=seed,
            classes=classes,
            skip_broken=skip_broken,
        )
        super().__init__(path, split, LAYOUT, options)
