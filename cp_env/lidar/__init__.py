"""A LiDAR over boxes: rays, occlusion, returns."""

from __future__ import annotations

from cp_env.lidar.sensor import DIGEST, RSU, VEHICLE, LidarSpec, fan, prisms, scan

__all__ = ["DIGEST", "RSU", "VEHICLE", "LidarSpec", "fan", "prisms", "scan"]
