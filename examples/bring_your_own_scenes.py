"""Scenes of your own: a `SceneSource` in 30 lines, checked, rendered and played.

    python examples/bring_your_own_scenes.py                      # writes a miniature to show with, in out/my-scenes
    python examples/bring_your_own_scenes.py --folder /data/mine  # yours, in this layout

The layout here: `<scene>/scene.npz` holds `dt` (s), `pose` (T, M, 3: x, y, yaw of every vehicle, NaN where absent),
`size` (M, 3), `connected` (A,: rows of the vehicles with a LiDAR, the ego first) and `mount` (A,: height of each, m);
`<scene>/<frame>-<agent>.npy` holds points (P, 3) as the sensor measured them: x forward, y left, z up, from the sensor,
which stands over the middle of its vehicle. Yours will differ: what matters is what `load` and `sweeps` return.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

import cp_env
from cp_env.lidar.returns import count_returns, standing
from cp_env.scenes import open_source
from cp_env.scenes.preview import film
from cp_env.testing import check_scenes
from cp_env.types import Scene, Sweep


class Folder:
    """The scenes of a folder in the layout above."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.name = folder, folder.name
        files = [f"{file} {file.stat().st_size} {file.stat().st_mtime_ns}" for file in sorted(folder.glob("*/*.np?"))]
        self.digest = hashlib.sha256("\n".join(files).encode()).hexdigest()  # encoded maps are cached under it

    def names(self) -> tuple[str, ...]:
        return tuple(sorted(file.parent.name for file in self.folder.glob("*/scene.npz")))

    def load(self, name: str) -> Scene:
        if name not in self.names():
            raise ValueError(f"no scene {name!r} in {self.folder}")
        with np.load(self.folder / name / "scene.npz") as a:
            nothing = np.zeros((0, 6))  # obstacles: only a ray-caster needs them
            return Scene(name, "recorded", float(a["dt"]), a["pose"], a["size"], a["connected"], None, nothing)

    def sweeps(self, scene: Scene, frames: Sequence[int]) -> list[list[Sweep]]:
        mount = np.load(self.folder / scene.name / "scene.npz")["mount"]
        return [[self._sweep(scene, int(t), agent, height) for agent, height in enumerate(mount)] for t in frames]

    def _sweep(self, scene: Scene, t: int, agent: int, height: float) -> Sweep:
        x, y, yaw = scene.pose[t, scene.connected[agent]]
        points = np.load(self.folder / scene.name / f"{t}-{agent}.npy")
        turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
        points = (points @ turn.T + [0, 0, height]).astype(np.float32)  # along the world's axes, z above ground
        return Sweep(points, np.array([x, y, height]), count_returns(points, standing(scene, t, np.array([x, y]))))


@dataclass
class Args:
    """Check, render and play scenes of your own."""

    folder: Path | None = None
    """yours; a miniature is written where there is none"""
    out: Path = Path("out/my-scenes")
    """where the miniature and the preview go"""
    n_vehicles: int = 3
    """how many share their maps when it is played"""
    frames: int = 8
    """frames of the miniature, and of the episode"""


def write_miniature(folder: Path, vehicles: int, frames: int) -> Path:
    """A scene of the town, as if it had been recorded in the layout above."""
    town = open_source("town/test")
    scene = town.load(town.names()[0])
    (folder / scene.name).mkdir(parents=True, exist_ok=True)
    for t, sweeps in enumerate(town.sweeps(scene, range(frames))):
        for agent, sweep in enumerate(sweeps[:vehicles]):
            yaw = scene.pose[t, scene.connected[agent], 2]
            turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
            np.save(folder / scene.name / f"{t}-{agent}.npy", (sweep.points - [0, 0, sweep.origin[2]]) @ turn)
    np.savez(
        folder / scene.name / "scene.npz",
        dt=scene.dt,
        pose=scene.pose[:frames],
        size=scene.size,
        connected=scene.connected[:vehicles],
        mount=[sweep.origin[2] for sweep in sweeps[:vehicles]],
    )
    return folder


def main(args: Args) -> None:
    """Check a new source, render it as a video, and play on it."""
    source = Folder(args.folder or write_miniature(args.out / "miniature", args.n_vehicles, args.frames))
    print(f"{len(check_scenes(source))} laws kept")
    name = source.names()[0]
    frames = range(min(source.load(name).n_frames, args.frames))
    film.write_gif(film.film(film.excerpt(source, name, frames)), args.out / "preview.gif", seconds=0.2)
    print(f"{args.out / 'preview.gif'}: {len(frames)} frames of {name}")
    env = cp_env.parallel_env(scenes=source, n_vehicles=args.n_vehicles, n_attackers=1, max_frames=args.frames)
    env.reset(seed=0)
    damage = 0.0
    while env.agents:
        *_, infos = env.step({agent: env.action_space(agent).sample() for agent in env.agents})
        damage += infos["adversary_0"]["damage"]
    print(f"played: detection loss/frame {damage / args.frames:.2f}, one attacker among {args.n_vehicles}")


if __name__ == "__main__":
    main(tyro.cli(Args))
