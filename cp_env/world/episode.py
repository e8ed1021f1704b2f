"""One encoded scene as N vehicles see it, and the views made of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Shaped
from torch import Tensor

from cp_env.detector.model.decoder import Dense
from cp_env.detector.protocol import DetectorLike
from cp_env.geometry.planar import grid_origin
from cp_env.types import Scene, View


@dataclass(frozen=True, eq=False)
class Episode:
    """One scene as N vehicles sense it: maps 0..n-1 are the first n connected vehicles', the road-side unit's the last.

    The ego frame of frame t is the grid frame of map 0 at t.
    """

    scene: Scene
    features: tuple[Float[np.ndarray, "T C H W"], ...]  # f_E of each map's sweeps, sender's grid frame
    received: tuple[Float[np.ndarray, "T C H W"], ...]  # the same, warped to the ego frame
    ego_T_sender: Float[Tensor, "T N 3"]  # m, m, rad
    coverage: Float[Tensor, "T N H W"]
    clean: Dense  # everyone fused, no attack; half precision, T views
    clean_views: tuple[View, ...]
    truth: tuple[Float[np.ndarray, "_ 5"], ...]  # strict: every vehicle in range, seen or hidden; ego frame
    ego_context: Shaped[np.ndarray, "T ..."] | None = None  # of the ego, if the detector uses it

    def maps(self, name: str, frame: int) -> Float[Tensor, "N C H W"]:
        """`features` or `received` of one frame, single precision."""
        return stack_maps([(self, frame)], name)[0]


def stack_maps(places: Sequence[tuple[Episode, int]], name: str) -> Float[Tensor, "E N C H W"]:
    """`features` or `received` of E (episode, frame), single precision, each map read straight to its place."""
    sources = [[maps[frame] for maps in getattr(episode, name)] for episode, frame in places]
    stacked = torch.empty(len(sources), len(sources[0]), *sources[0][0].shape)
    for rows, maps in zip(stacked, sources, strict=True):
        for row, one in zip(rows, maps, strict=True):
            row.copy_(torch.from_numpy(one))
    return stacked


def stack_ego_context(
    places: Sequence[tuple[Episode, int]], device: torch.device | str = "cpu"
) -> Shaped[Tensor, "E ..."] | None:
    """The ego context of E (episode, frame); None if the detector uses none."""
    rows = [episode.ego_context[frame] for episode, frame in places if episode.ego_context is not None]
    return torch.from_numpy(np.stack(rows)).to(device) if rows else None


def ego_place(scene: Scene, frame: int) -> Float[np.ndarray, " 2"]:
    """Where the ego stands in the world; m."""
    return scene.pose[frame, scene.connected[0], :2]


def make_views(
    detector: DetectorLike,
    dense: Dense,
    groups: list[frozenset[int]],
    frames: list[int],
    places: list[Float[np.ndarray, " 2"]],
) -> list[View]:
    """Detections and score map of each row of `dense`, as the opaque views that defenders compare.

    Args:
        detector: what made `dense`.
        dense: the decoder's output, one row a view.
        groups: the vehicles fused in each row.
        frames: the frame of each row.
        places: the ego's position in each row, m: the others detect the ego too, and its box is left out.

    Returns:
        One `View` a row.
    """
    origins = [grid_origin(place) for place in places]
    own = np.stack([place - origin for place, origin in zip(places, origins, strict=True)])
    score_maps = dense.scores.detach().cpu().numpy()
    return [
        View(group, frame, origin, found, found.above(detector.threshold), score_map)
        for group, frame, origin, found, score_map in zip(
            groups, frames, origins, detector.detect(dense, own), score_maps, strict=True
        )
    ]
