"""The bounds of the pseudo-closed loop: drives on the truth, and drives on nothing, over whole scenes.

    python examples/reproduce/driving_bounds.py
    python examples/reproduce/driving_bounds.py --scenes town/calibration

The first is what perfect perception reaches: what it does wrong is the driver's or the replay's own. The second is what
an ego meets that sees no vehicle at all. No detector runs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import tyro
from jaxtyping import Float
from rich.console import Console
from rich.table import Table

from cp_env.driving import Drive, PseudoClosedLoop
from cp_env.geometry.planar import grid_origin
from cp_env.metrics.ground_truth import truth_boxes
from cp_env.metrics.intervals import rate_interval, t_interval
from cp_env.metrics.surroundings import surroundings
from cp_env.scenes import open_source
from cp_env.types import Detections, Scene, View

EXTENT = 32.0  # m to each side
Perceive = Callable[[Scene, int], Float[np.ndarray, "_ 5"]]


@dataclass(frozen=True)
class Args:
    """What is driven."""

    scenes: str = "town/test"


def truth(scene: Scene, frame: int) -> Float[np.ndarray, "_ 5"]:
    """Every vehicle in range."""
    return truth_boxes(scene, frame, int(scene.connected[0]), EXTENT).astype(np.float64)


def nothing(scene: Scene, frame: int) -> Float[np.ndarray, "_ 5"]:
    """No vehicle."""
    return np.zeros((0, 5))


def drive(scene: Scene, perceive: Perceive) -> Drive:
    """The drive from the scene's first frame to its last."""
    loop = PseudoClosedLoop([scene], [0])
    for frame in range(scene.n_frames):
        boxes = perceive(scene, frame)
        seen = Detections(boxes, np.ones(len(boxes)))
        origin = grid_origin(scene.pose[frame, int(scene.connected[0]), :2])
        loop.step([View(frozenset({0}), frame, origin, seen, seen, np.zeros((1, 1)))])
    return loop.drives()[0]


def main(args: Args) -> None:
    source = open_source(args.scenes)
    scenes = [source.load(name) for name in source.names()]
    table = Table(title=f"{len(scenes)} drives, {args.scenes}")
    for heading in ("perceived", "collisions", "hard brakings a drive", "mean speed (m/s)"):
        table.add_column(heading)
    for name, perceive in (("every vehicle in range", truth), ("nothing", nothing)):
        drives = [drive(scene, perceive) for scene in scenes]
        collisions = rate_interval(sum(one.collided for one in drives), len(drives))
        braking = t_interval([one.hard_brakings for one in drives], least=0.0)
        speed = t_interval([one.mean_speed for one in drives], least=0.0)
        table.add_row(name, f"{collisions:.2f}", f"{braking:.2f}", f"{speed:.2f}")
    critical = [surroundings(s, t, EXTENT).critical for s in scenes for t in range(s.n_frames)]
    Console().print(table)
    Console().print(
        f"critical vehicles: {np.mean([c.sum() for c in critical]):.2f} of {np.mean([c.size for c in critical]):.1f} "
        f"in range in a frame; {np.mean([c.any() for c in critical]):.2f} of the frames hold one"
    )


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
