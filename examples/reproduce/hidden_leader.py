"""One episode in which the car ahead is hidden: what the driver does about it, beside the same drive unattacked.

    python examples/reproduce/hidden_leader.py
    python examples/reproduce/hidden_leader.py --scene test-urban-04 --defender robosac

The ego follows its recorded path behind what it perceives, while all others replay (`cp_env.driving`). Two of five
vehicles attack from the second frame on; the seed draws them. The episode was chosen because it ends in a collision.
How often that happens is a matter of tables over scenes.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import torch
import tyro
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from rich.console import Console

from agents.arena import make_attack
from cp_env import evaluation
from cp_env.driving import Drive, PseudoClosedLoop
from cp_env.driving.closed_loop import HARD
from cp_env.geometry.planar import compose, corners, invert
from cp_env.metrics.corridor import WIDTH
from cp_env.rendering import style
from cp_env.types import Scene

EGO, HIDDEN, SEEN, OTHER, BAND = style.BLACK, style.LIGHT.missed, style.LIGHT.found, style.SILVER, "#EDF1F5"
CALM, ATTACKED = style.BLUE, style.VERMILLION
"""The drive on the unattacked output, and the other."""
BEHIND, AHEAD, SIDE = 8.0, 32.0, 5.0
"""What is shown of the road: m behind, ahead of and beside the ego."""


@dataclass(frozen=True)
class Args:
    """What is played."""

    scenes: str = "town/test"
    scene: str = "test-suburban-03"
    start: int = 0  # first frame of the scene
    frames: int = 60
    defender: str = "prbi"
    attack: str = "nearest_removal:steps=8"
    n_attackers: int = 2
    seed: int = 0
    out: Path = Path("out/hidden_leader.png")


@dataclass(frozen=True, eq=False)
class Episode:
    """What is drawn of it. First axis: frames."""

    scene: Scene
    start: int
    attacked: PseudoClosedLoop
    clean: PseudoClosedLoop
    place: list[Float[np.ndarray, " 3"]]  # of the ego that drives on the attacked output; world frame
    seen: list[Float[np.ndarray, "_ 5"]]  # boxes that it perceives there; world frame
    damage: float  # per frame
    attackers: list[int]


def play(args: Args) -> Episode:
    """The episode: one output, two drives, of which one is shown the unattacked views."""
    conditions = evaluation.Conditions(args.scenes, (args.scene,), args.frames)
    bank, attack = evaluation.open_bank(conditions), make_attack(args.attack)
    run = evaluation.Run(args.defender, args.attack, args.n_attackers, args.seed, conditions.names)
    rollout = evaluation.Rollout(run, conditions, bank, attack)
    world = rollout.world
    world.reset([np.random.SeedSequence(args.seed)], options=[{"scene": args.scene, "start": args.start}])
    scene = world.places[0][0].scene
    attacked, calm = (PseudoClosedLoop([scene], [args.start]) for _ in range(2))
    place, seen, damage = [], [], []
    for _ in range(min(args.frames, scene.n_frames - args.start)):
        outcome = rollout.step()
        (output,), (clean,) = outcome.output, outcome.clean
        boxes = output.seen.boxes.astype(np.float64)
        boxes[:, :2] += output.origin
        place.append(attacked.place(0))
        seen.append(boxes)
        damage.append(float(outcome.damage[0]))
        attacked.step([output])
        calm.step([clean])
    attackers: list[int] = world.attackers[0].tolist()
    return Episode(scene, args.start, attacked, calm, place, seen, float(np.mean(damage)), attackers)


@style.plot_style()
def draw(episode: Episode, args: Args) -> Path:
    """The road at two moments, then the two drives over time."""
    hit = collision_frame(episode)
    end = len(episode.place) - 1 if hit is None else hit
    figure = plt.figure(figsize=(style.PAGE, 7.0), layout="constrained")
    rows = figure.add_gridspec(4, 1, height_ratios=[1, 1, 0.95, 0.95])
    for row, frame in enumerate((max(end - 10, 0), end)):
        axes = figure.add_subplot(rows[row])
        draw_road(axes, episode, frame)
        before = f"{(end - frame) * episode.scene.dt:.0f} s before"
        what = before if frame < end else "the end" if hit is None else "the collision"
        axes.set_title(f"t = {frame * episode.scene.dt:.1f} s, {what}", loc="left", fontsize=9)
    figure.axes[0].legend(
        handles=[
            Patch(facecolor=EGO, label="ego (simulated)"),
            Patch(facecolor=HIDDEN, edgecolor=style.BLACK, label="vehicle that it misses"),
            Patch(facecolor=OTHER, label="vehicle that it sees"),
            Line2D([], [], color=SEEN, lw=1.8, label="box of the output"),
            Patch(facecolor=BAND, label="its corridor"),
        ],
        ncols=3,
        fontsize=8,
        loc="lower center",
        bbox_to_anchor=(0.5, 1.14),
        frameon=False,
        handlelength=1.4,
        columnspacing=1.0,
    )
    speed, braking = figure.add_subplot(rows[2]), figure.add_subplot(rows[3])
    draw_series(speed, episode, "speed", 1.0, "speed (m/s)")
    draw_series(braking, episode, "acceleration", -1.0, "braking (m/s²)")
    braking.axhline(HARD, color="black", lw=0.8, ls=":")
    braking.annotate("hard", (0, HARD), (2, 2), textcoords="offset points", fontsize=8)
    braking.set_xlabel("time (s)", fontsize=9)
    braking.set_ylim(bottom=0)
    for axes in (speed, braking):
        axes.axvline(end * episode.scene.dt, color=style.GREY, lw=1, ls="--")
    speed.legend(fontsize=8, frameon=False, loc="best")
    args.out.parent.mkdir(parents=True, exist_ok=True)
    style.save_plot(figure, args.out)
    plt.close(figure)
    return args.out


def collision_frame(episode: Episode) -> int | None:
    """The frame in which the attacked drive ends in a collision."""
    if not episode.attacked.drives()[0].collided:
        return None
    speed = [float(moment.speed[0]) for moment in episode.attacked.history]
    moving = [t for t, value in enumerate(speed) if value > 0]
    return min(moving[-1] + 1, len(speed) - 1)


def draw_road(axes: Axes, episode: Episode, frame: int) -> None:
    """The road from the simulated ego's place, which heads to the right."""
    place = episode.place[frame]
    pose = episode.scene.pose[episode.start + frame]
    ego = int(episode.scene.connected[0])
    rows = np.array([row for row in np.flatnonzero(np.isfinite(pose[:, 0])) if row != ego])
    boxes = np.concatenate([pose[rows, :2], episode.scene.size[rows, :2], pose[rows, 2:]], axis=1)
    seen = episode.seen[frame]
    found = (np.linalg.norm(boxes[:, None, :2] - seen[None, :, :2], axis=-1) <= 2.0).any(axis=1)
    axes.axhspan(-WIDTH / 2, WIDTH / 2, color=BAND, lw=0)
    add(axes, from_ego(boxes[found], place), facecolors=OTHER)
    add(axes, from_ego(boxes[~found], place), facecolors=HIDDEN, edgecolors=style.BLACK, linewidths=0.8)
    add(axes, np.array([[0, 0, *episode.scene.size[ego, :2], 0]]), facecolors=EGO)
    add(axes, from_ego(seen, place), facecolors="none", edgecolors=SEEN, linewidths=1.8)
    axes.set(xlim=(-BEHIND, AHEAD), ylim=(-SIDE, SIDE), aspect="equal", yticks=[-4, 0, 4])
    axes.set_ylabel("left (m)", fontsize=9)
    axes.set_xlabel("ahead of the ego (m)", fontsize=9)
    axes.grid(False)
    axes.tick_params(labelsize=8)


def from_ego(boxes: Float[np.ndarray, "L 5"], place: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "L 5"]:
    """The boxes of the world frame in the frame of the simulated ego."""
    pose = compose(np.broadcast_to(invert(place), (len(boxes), 3)), boxes[:, [0, 1, 4]])
    return np.concatenate([pose[:, :2], boxes[:, 2:4], pose[:, 2:]], axis=1)


def add(axes: Axes, boxes: Float[np.ndarray, "L 5"], **drawn: object) -> None:
    """Draw boxes."""
    axes.add_collection(PolyCollection(list(corners(boxes)), **drawn))  # type: ignore[arg-type]


def draw_series(axes: Axes, episode: Episode, name: str, sign: float, label: str) -> None:
    """Both drives over time."""
    for loop, colour, dashes, what in (
        (episode.clean, CALM, "--", "sees the unattacked output"),
        (episode.attacked, ATTACKED, "-", "sees the attacked, defended output"),
    ):
        values = [sign * float(getattr(moment, name)[0]) for moment in loop.history]
        axes.plot(np.arange(len(values)) * episode.scene.dt, values, dashes, color=colour, lw=1.8, label=what)
    axes.set_ylabel(label, fontsize=9)
    axes.tick_params(labelsize=8)
    axes.spines[["top", "right"]].set_visible(False)


def described(what: str, drive: Drive) -> str:
    """A drive in a line."""
    end = f"collides at {drive.impact_speed:.1f} m/s" if drive.collided else "does not collide"
    return (
        f"{what}: {end}, {drive.hard_brakings} hard brakings (hardest {drive.hardest_braking:.1f} m/s²), "
        f"mean speed {drive.mean_speed:.1f} m/s"
    )


def main(args: Args) -> None:
    torch.set_num_threads(1)
    episode, console = play(args), Console()
    console.print(described("unattacked", episode.clean.drives()[0]), soft_wrap=True)
    console.print(described("attacked", episode.attacked.drives()[0]), soft_wrap=True)
    console.print(f"detection loss/frame {episode.damage:.2f}, attackers {episode.attackers}")
    console.print("written:", draw(episode, args))


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
