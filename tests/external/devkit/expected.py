"""Export scenes of the town as V2X-Sim, and write down what the nuScenes devkit should find in them.

python -m tests.external.devkit.expected out/devkit
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import numpy as np

from cp_env.scenes import Town
from cp_env.scenes.clip import Clip
from cp_env.scenes.export import export


def main(out: Path) -> None:
    """Boxes, sensor poses and points of every frame, in the world frame, straight from the source."""
    shutil.rmtree(out, ignore_errors=True)
    source = Clip(Town("test"), frames=3, vehicles=4)
    names = source.names()[:3]
    export(source, out / "set", names=names)
    found: dict[str, np.ndarray] = {}
    for name in names:
        scene = source.load(name)
        for t, sweeps in enumerate(source.sweeps(scene, range(scene.n_frames))):
            there = ~np.isnan(scene.pose[t, :, 0])
            pose, size = scene.pose[t, there], scene.size[there]
            found[f"{name}/{t}/boxes"] = np.column_stack([pose[:, :2], size[:, 2] / 2, size, pose[:, 2]])
            yaws = [*scene.pose[t, scene.connected, 2], *([] if scene.rsu is None else [0.0])]
            for agent, (sweep, yaw) in enumerate(zip(sweeps, yaws, strict=True), start=1):
                key = f"{name}/{t}/LIDAR_TOP_id_{agent % (scene.n_connected + 1)}"
                found[f"{key}/pose"] = np.append(sweep.origin, yaw)
                found[f"{key}/points"] = sweep.points + sweep.origin * (1, 1, 0)
    np.savez(out / "expected.npz", **found)  # type: ignore[arg-type]


if __name__ == "__main__":
    main(Path(sys.argv[1]))
