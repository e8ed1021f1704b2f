"""Peak memory of reading recorded drives: it is that of a frame, however many are played.

    python -m benchmarks.memory

Each number is that of a process of its own, which opens a scenario of five vehicles (or as many as the layout has) with
about 60,000 points a sweep, loads it, and reads so many of its frames one after the other, as the environment does. It
is the largest resident set while they are read, less the resident set before. Linux only: the peak is reset through
/proc.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import tyro

from cp_env.scenes import open_source
from cp_env.types import Scene, SceneSource, Sweep

LAYOUTS = ("opv2v", "v2x-sim", "v2v4real", "v2x-real", "dair-v2x", "nuscenes")
RUN = "import sys; from benchmarks.memory import play; play(sys.argv[1], int(sys.argv[2]))"


@dataclass(frozen=True)
class Args:
    """What is measured."""

    layouts: tuple[str, ...] = LAYOUTS
    """of the sets"""
    frames: int = 40
    """of the scenario"""
    played: tuple[int, ...] = (1, 10)
    """frames that are read; all of them, besides"""


class Repeated:
    """A dense town whose every frame has the sweeps of its first: casting 60,000 rays a sensor takes seconds."""

    def __init__(self, frames: int) -> None:
        from cp_env import lidar
        from cp_env.scenes import Town
        from cp_env.scenes.clip import Clip

        source = Clip(Town("test"), frames=frames, vehicles=5)
        self.name, self.digest = source.name, f"{source.digest}-dense"
        self._name = max(source.names(), key=lambda name: len(source.load(name).size))
        self._scene = source.load(self._name)
        spec = lidar.LidarSpec(elevations=lidar.fan(-24.0, 3.0, 64), azimuths=1024)
        self._first = lidar.scan([(self._scene, 0)], vehicle_spec=spec)[0]

    def names(self) -> tuple[str, ...]:
        return (self._name,)

    def load(self, name: str) -> Scene:
        return self._scene

    def sweeps(self, scene: Scene, frames: Sequence[int]) -> list[list[Sweep]]:
        agents = [*range(scene.n_connected), *([None] if scene.rsu is not None else [])]
        origins = []
        for t in frames:
            row = []
            for agent, sweep in zip(agents, self._first, strict=True):
                place = sweep.origin.copy()
                if agent is not None:
                    place[:2] = scene.pose[t, scene.connected[agent], :2]
                row.append(Sweep(sweep.points, place, sweep.hits))
            origins.append(row)
        return origins


def write(source: SceneSource, layout: str, root: Path) -> str:
    """The source in a layout; the name under which it is opened."""
    from cp_env.scenes.export import export
    from cp_env.scenes.opv2v import writer
    from tests.helpers import dair_sets, nuscenes_sets

    if layout in ("v2v4real", "v2x-real"):
        writer.write(source, source.names(), root, kind=layout)
    elif layout == "dair-v2x":
        dair_sets.write_set(source, root)
        return f"dair-v2x:{root}?stride=1"
    elif layout == "nuscenes":
        nuscenes_sets.write_set(source, root, ["scene-0061"])
        return f"nuscenes:{root}?progress=no"
    else:
        export(source, root, layout=layout)
    return f"{layout}:{root}" + ("?progress=no" if layout == "v2x-sim" else "")


def play(spec: str, frames: int) -> None:
    """Read the first frames of a set's only scene, one after the other; print by how much the peak rises, in KiB."""
    source = open_source(spec)
    scene = source.load(source.names()[0])
    import scipy.interpolate  # what a hill needs, so that no import counts as memory of a frame
    import scipy.ndimage

    assert scipy
    Path("/proc/self/clear_refs").write_text("5")
    before = _status("VmRSS")
    for t in range(min(frames, scene.n_frames)):
        source.sweeps(scene, [t])
    print(_status("VmHWM") - before)


def _status(name: str) -> int:
    """A line of the process's own status; KiB."""
    return next(int(line.split()[1]) for line in Path("/proc/self/status").read_text().splitlines() if name in line)


def measure(spec: str, frames: int) -> float:
    """How much the peak of a process rises that reads so many frames; MiB."""
    found = subprocess.run([sys.executable, "-c", RUN, spec, str(frames)], capture_output=True, text=True, check=True)
    return int(found.stdout.split()[-1]) / 1024


def main(args: Args) -> None:
    """Write the sets, measure, and print a table."""
    source = Repeated(args.frames)
    played = (*args.played, args.frames)
    print(f"{'layout':12}" + "".join(f"{f'{n} frames':>12}" for n in played) + "   MiB")
    for layout in args.layouts:
        with tempfile.TemporaryDirectory() as folder:
            spec = write(source, layout, Path(folder) / "set")
            print(f"{layout:12}" + "".join(f"{measure(spec, frames):12.0f}" for frames in played), flush=True)


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
