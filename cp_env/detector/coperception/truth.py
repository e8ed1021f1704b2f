"""coperception's ground truth where our detections are: chosen in the ego's own frame, given in its grid frame."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from cp_env.geometry.planar import compose, grid_origin
from cp_env.metrics.ground_truth import truth_boxes
from cp_env.types import Scene


def their_truth(
    scene: Scene, frame: int, ego: int, extent: float = 32.0, *, own: bool = True
) -> Float[np.ndarray, "L 5"]:
    """The cars that their AP counts: centres up to half a metre beyond ±extent along the ego's axes, itself among them.

    `truth_boxes(…, protocol="coperception", axes="ego")` chooses them; here they are moved to the frame in which an
    environment's detections lie, whose axes are the world's.

    Args:
        scene: the scene.
        frame: number of the frame.
        ego: row of the ego among the scene's vehicles.
        extent: reach of the map to each side; m.
        own: whether the ego's own car counts, as it does there. A detector that drops its own box misses it in every
            frame: leave it out for such a one.

    Returns:
        x, y, length, width, yaw in the ego's grid frame; m, rad.
    """
    boxes = truth_boxes(scene, frame, ego, extent, "coperception", "ego").astype(np.float64)
    if not own:
        boxes = boxes[np.hypot(boxes[:, 0], boxes[:, 1]) > 1e-3]  # it stands at the origin, and nobody else does
    x, y, yaw = scene.pose[frame, ego]
    grid_T_ego = np.array([*((x, y) - grid_origin(np.array([x, y]))), yaw])
    placed = compose(np.broadcast_to(grid_T_ego, (len(boxes), 3)), boxes[:, [0, 1, 4]])
    return np.concatenate([placed[:, :2], boxes[:, 2:4], placed[:, 2:]], axis=1).astype(np.float32)
