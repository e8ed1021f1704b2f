"""V2V4Real: two real vehicles, in OPV2V's folders.

    open_source("v2v4real:/data/V2V4Real?split=test")

Source: Xu et al., "V2V4Real", CVPR 2023, and its public code, whose layout this reader follows.

Convention: right-handed. `lidar_pose` is a 4 × 4 matrix, world_T_lidar, that PyYAML wrote from a numpy array. Objects
are given in the LiDAR frame of the agent that lists them and are numbered by it; those that both see share an `ass_id`.
Files are numbered one by one, at 10 Hz.
"""

from __future__ import annotations

from pathlib import Path

from cp_env.scenes.opv2v.classes import DEFAULT
from cp_env.scenes.opv2v.layouts import V2V4REAL
from cp_env.scenes.opv2v.recorded import Options, Recorded
from cp_env.types import Scene


class V2V4Real(Recorded):
    """One split of V2V4Real (a `SceneSource`).

    The first agent by name, "0", is the ego. An agent's folder is not named by its vehicle's number: a connected
    vehicle is the listed object under its sensor, if there is one. The road under a sensor lies at the bottom of boxes
    near it.

    Args:
        path: the data set's folder, or the folder of one split.
        split: name of the folder inside it, such as "train", "validate" or "test", or "train_01" as it is downloaded.
        scenes: names of scenarios, or of pieces of them; all by default.
        vehicles: leave out scenarios with fewer; all have two.
        stride: every so many files are a frame; by default 2, which gives 5 frames a second.
        tick: seconds from one file number to the next; by default 0.1, and an error if the files contradict it.
        noise: deviations of the place (m) and the heading (degrees) at which the ego takes the other to be.
        seed: of the noise.
        classes: what counts as a vehicle: groups and types of `classes.CLASSES`, a leading "-" leaves a type out.
        angles: "degrees", "radians", or "auto": radians if nothing listed in ten frames, spread over a scene, is
            turned by more than 3.15.
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
        noise: tuple[float, ...] = (0.0, 0.0),
        seed: int = 0,
        classes: tuple[str, ...] = DEFAULT,
        angles: str = "auto",
        skip_broken: bool = False,
    ) -> None:
        options = Options(
            scenes=scenes,
            vehicles=vehicles,
            stride=stride,
            tick=tick,
            noise=noise,
            seed=seed,
            classes=classes,
            angles=angles,
            skip_broken=skip_broken,
        )
        super().__init__(path, split, V2V4REAL, options)

    def classes(self, scene: Scene) -> tuple[str, ...]:
        """The `obj_type` of each of the scene's vehicles, "vehicle" where no file gives it."""
        return self._kinds(scene)
