"""V2X-Real: real vehicles and road-side units, in OPV2V's folders.

    open_source("v2x-real:/data/V2X-Real?split=test&classes=vehicle,pedestrian")

Source: Xiang et al., "V2X-Real", ECCV 2024, and its public code, whose layout this reader follows.

Convention: right-handed. Poses are six numbers in degrees; objects are given in the world, with one number for all
agents, and have an `obj_type`. Points are `.bin` files of x, y, z, intensity. Files are numbered one by one, at 10 Hz.
"""

from __future__ import annotations

from pathlib import Path

from cp_env.scenes.opv2v.classes import DEFAULT
from cp_env.scenes.opv2v.layouts import V2X_REAL
from cp_env.scenes.opv2v.recorded import Options, Recorded
from cp_env.types import Scene


class V2XReal(Recorded):
    """One split of V2X-Real (a `SceneSource`).

    Agents are the vehicles by name, the first is the ego, and the first road-side unit; scenarios of units alone are
    left out. An agent's folder is not named by its vehicle's number: a connected vehicle is the listed object under its
    sensor, if there is one. The road under a sensor lies at the bottom of boxes near it.

    Args:
        path: the data set's folder, or the folder of one split.
        split: name of the folder inside it, such as "train", "validate" or "test".
        scenes: names of scenarios, or of pieces of them; all by default.
        vehicles: leave out scenarios with fewer.
        stride: every so many files are a frame; by default 2, which gives 5 frames a second.
        tick: seconds from one file number to the next; by default 0.1, and an error if the files contradict it.
        rsu: whether scenes show their road-side unit.
        noise: deviations of the place (m) and the heading (degrees) at which the ego takes others to be.
        seed: of the noise.
        classes: what counts as a vehicle: groups and types of `classes.CLASSES`, a leading "-" leaves a type out.
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
            noise=noise,
            seed=seed,
            classes=classes,
            skip_broken=skip_broken,
        )
        super().__init__(path, split, V2X_REAL, options)

    def classes(self, scene: Scene) -> tuple[str, ...]:
        """The `obj_type` of each of the scene's vehicles, "vehicle" where no file gives it."""
        return self._kinds(scene)
