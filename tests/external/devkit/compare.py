"""Load an exported set in the nuScenes devkit and compare boxes, poses and points with what was exported.

Runs in an environment of its own (`make devkit`): the devkit needs numpy < 2. It imports nothing of this project.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from nuscenes.nuscenes import NuScenes
from nuscenes.utils.data_classes import LidarPointCloud
from nuscenes.utils.geometry_utils import transform_matrix
from pyquaternion import Quaternion

MILLIMETRE = 1e-3


def main(out: Path) -> None:
    """Print the largest difference of each kind; fail if any exceeds a millimetre or a milliradian."""
    nusc = NuScenes(version="v2.0", dataroot=str(out / "set"), verbose=False)
    expected = dict(np.load(out / "expected.npz"))
    worst = {"boxes": 0.0, "poses": 0.0, "points": 0.0}
    frames = sweeps = counted = 0
    for scene in nusc.scene:
        token, t = scene["first_sample_token"], 0
        while token:
            sample = nusc.get("sample", token)
            boxes = nusc.get_boxes(next(iter(sample["data"].values())))
            found = np.array([[*b.center, *b.wlh[[1, 0, 2]], b.orientation.yaw_pitch_roll[0]] for b in boxes])
            counted += len(found)
            differ(worst, "boxes", found, expected.pop(f"{scene['name']}/{t}/boxes"))
            for channel, sweep in sample["data"].items():
                key = f"{scene['name']}/{t}/{channel}"
                pose, points = read(nusc, sweep)
                differ(worst, "poses", pose, expected.pop(f"{key}/pose"))
                differ(worst, "points", points, expected.pop(f"{key}/points"), angles=False)
                sweeps += 1
            token, t, frames = sample["next"], t + 1, frames + 1
    assert not expected, f"the devkit does not find {sorted(expected)}"
    print(f"nuScenes devkit: {len(nusc.scene)} scenes, {frames} frames, {sweeps} sweeps, {counted} boxes")
    print("largest difference: " + ", ".join(f"{kind} {value:.1e}" for kind, value in worst.items()) + " (m, rad)")
    assert max(worst.values()) < MILLIMETRE


def read(nusc: NuScenes, token: str) -> tuple[np.ndarray, np.ndarray]:
    """x, y, z, yaw of a sweep's sensor, and its points, in the world frame."""
    record = nusc.get("sample_data", token)
    mount = nusc.get("calibrated_sensor", record["calibrated_sensor_token"])
    ego = nusc.get("ego_pose", record["ego_pose_token"])
    chain = [transform_matrix(r["translation"], Quaternion(r["rotation"])) for r in (ego, mount)]
    world_T_sensor = chain[0] @ chain[1]
    cloud = LidarPointCloud.from_file(nusc.get_sample_data_path(token))
    cloud.transform(world_T_sensor)
    yaw = np.arctan2(world_T_sensor[1, 0], world_T_sensor[0, 0])
    return np.append(world_T_sensor[:3, 3], yaw), cloud.points[:3].T


def differ(worst: dict[str, float], kind: str, found: np.ndarray, expected: np.ndarray, angles: bool = True) -> None:
    """Note the largest difference; the last number is an angle."""
    assert found.shape == expected.shape, f"{kind}: {found.shape}, not {expected.shape}"
    difference = np.abs(found - expected)
    if angles:
        difference[..., -1] = np.abs(np.sin((found - expected)[..., -1] / 2)) * 2
    worst[kind] = max(worst[kind], float(difference.max()))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
