"""Draw the frames of V2X-Sim on data: the picture in `docs/v2x-sim.md`.

    python examples/v2xsim_axes.py                                                # the shipped town, exported
    python examples/v2xsim_axes.py --scenes "v2x-sim:/data/V2X-Sim-2.0?scenes=8"  # yours: do boxes and points agree?

Left: the world, with every sensor's pose, boxes and all points. Right: one sweep as its file stores it, with the boxes
taken into the sensor's frame by `world_T_sensor`. If an axis were swapped, points would miss the boxes.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import tyro
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection

from cp_env.geometry.planar import compose, corners, invert
from cp_env.rendering import style
from cp_env.scenes import Town, open_source
from cp_env.scenes.export import export
from cp_env.types import Scene, Sweep

REACH = 40.0  # m, drawn to each side
APART = 15.0  # m; of vehicles closer than that, only the first shows its axes
COLOURS = (style.BLUE, style.ORANGE, style.GREEN, style.PURPLE, style.SKY)
AHEAD, LEFT = style.VERMILLION, style.BLUE  # the x and the y axis


@dataclass(frozen=True)
class Args:
    """Which frame, and where the picture goes."""

    scenes: str | None = None  # by default the first test scene of the town is exported to a temporary folder
    frame: int = 0
    out: Path = Path("docs/v2x-sim-axes.png")


def draw_boxes(ax: Axes, boxes: Float[np.ndarray, "M 5"], colour: str) -> None:
    """Outlines, with a line from the middle to the front."""
    ax.add_collection(PolyCollection(list(corners(boxes)), facecolor="none", edgecolor=colour, linewidth=0.9))
    front = boxes[:, :2] + boxes[:, 2:3] / 2 * np.column_stack([np.cos(boxes[:, 4]), np.sin(boxes[:, 4])])
    ax.plot(*np.stack([boxes[:, :2], front]).transpose(2, 0, 1), color=colour, linewidth=0.9)


def draw_axes(ax: Axes, pose: Float[np.ndarray, "3"], length: float, name: str) -> None:
    """The x axis in orange, the y axis in blue, of a frame standing at `pose`."""
    for turn, colour, axis in ((0.0, AHEAD, "x"), (np.pi / 2, LEFT, "y")):
        x, y = length * np.cos(pose[2] + turn), length * np.sin(pose[2] + turn)
        ax.annotate(
            "",
            (pose[0] + x, pose[1] + y),
            (pose[0], pose[1]),
            arrowprops={"arrowstyle": "->", "color": colour, "lw": 2},
        )
        write(ax, pose[0] + 1.3 * x, pose[1] + 1.3 * y, axis, colour)
    write(ax, pose[0] - 0.7 * length * np.cos(pose[2]), pose[1] - 0.7 * length * np.sin(pose[2]), name, "black")


def write(ax: Axes, x: float, y: float, text: str, colour: str) -> None:
    """A word on a white ground, cut off at the edge of the picture."""
    ground = {"boxstyle": "round,pad=0.15", "fc": "white", "ec": "none", "alpha": 0.85}
    ax.text(
        x, y, text, color=colour, ha="center", va="center", weight="bold", size=8, bbox=ground, zorder=5, clip_on=True
    )


def boxes_of(scene: Scene, frame: int) -> Float[np.ndarray, "M 5"]:
    """x, y, length, width, yaw of those that are there, in the world."""
    there = ~np.isnan(scene.pose[frame, :, 0])
    pose = scene.pose[frame, there]
    return np.column_stack([pose[:, :2], scene.size[there, :2], pose[:, 2]])


def draw_world(ax: Axes, scene: Scene, frame: int, sweeps: list[Sweep]) -> None:
    """All sweeps and boxes, the sensors' headings."""
    for number, sweep in enumerate(sweeps[: scene.n_connected]):
        high = sweep.points[:, 2] > 0.3
        place = sweep.points[high, :2] + sweep.origin[:2]
        ax.scatter(place[:, 0], place[:, 1], s=0.4, color=COLOURS[number % len(COLOURS)], linewidths=0)
    draw_boxes(ax, boxes_of(scene, frame), "black")
    drawn = np.zeros((0, 2))
    for number, pose in enumerate(scene.pose[frame, scene.connected], start=1):
        if (np.hypot(*(drawn - pose[:2]).T) > APART).all():
            draw_axes(ax, pose, 6.0, str(number))
            drawn = np.concatenate([drawn, pose[None, :2]])
    centre = scene.pose[frame, scene.connected[0], :2]
    ax.set(xlim=(centre[0] - REACH, centre[0] + REACH), ylim=(centre[1] - REACH, centre[1] + REACH))
    ax.set(title="world: points, boxes and sensors", xlabel="x in the world, m", ylabel="y in the world, m")


def draw_sensor(ax: Axes, scene: Scene, frame: int, sweep: Sweep) -> None:
    """The first sweep in its sensor's own frame, coloured by height."""
    world_T_sensor = np.append(sweep.origin[:2], scene.pose[frame, scene.connected[0], 2])
    cos, sin = np.cos(world_T_sensor[2]), np.sin(world_T_sensor[2])
    own = sweep.points[:, :2] @ np.array([[cos, -sin], [sin, cos]])
    shown = ax.scatter(own[:, 0], own[:, 1], s=0.6, c=sweep.points[:, 2], cmap="viridis", vmin=0, vmax=4, linewidths=0)
    ax.figure.colorbar(shown, ax=ax, label="height above ground, m", location="bottom", shrink=0.8)
    boxes = boxes_of(scene, frame)
    pose = compose(np.broadcast_to(invert(world_T_sensor), (len(boxes), 3)), boxes[:, [0, 1, 4]])
    draw_boxes(ax, np.column_stack([pose[:, :2], boxes[:, 2:4], pose[:, 2]]), "black")
    draw_axes(ax, np.zeros(3), 8.0, "1")
    ax.set(xlim=(-REACH, REACH), ylim=(-REACH, REACH), title="the file of sensor 1: its own frame")
    ax.set(xlabel="x ahead of the sensor, m", ylabel="y to the left of the sensor, m")


def main(args: Args) -> None:
    """Read one frame, draw it twice."""
    with tempfile.TemporaryDirectory() as folder:
        spec = args.scenes
        if spec is None:
            town = Town("test")
            export(town, Path(folder) / "set", names=town.names()[:1], frames=args.frame + 1, vehicles=5)
            spec = f"v2x-sim:{folder}/set"
        source = open_source(spec)
        scene = source.load(source.names()[0])
        (sweeps,) = source.sweeps(scene, [args.frame])
    with style.plot_style():
        figure, (left, right) = plt.subplots(1, 2, figsize=(style.PAGE, 4.2), layout="compressed")
        draw_world(left, scene, args.frame, sweeps)
        draw_sensor(right, scene, args.frame, sweeps[0])
        for ax in (left, right):
            ax.set_aspect("equal")
            ax.grid(False)
        style.save_plot(figure, args.out)
    print(f"{args.out}: scene {scene.name} of {source.name}, frame {args.frame}")


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
