"""One scene as N vehicles see it, computed frame by frame, and the views made of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Float16, Int, Shaped
from torch import Tensor

from cp_env.detector.model.decoder import Dense
from cp_env.detector.protocol import DetectorLike, dtype_of
from cp_env.geometry.planar import grid_origin
from cp_env.types import Scene, View
from cp_env.world import received
from cp_env.world.map_store import BLOCK, MapStore
from cp_env.world.per_frame import PerFrame


class CleanFrame(NamedTuple):
    """The ego's output of one frame with everyone fused and no attack."""

    logits: Float16[Tensor, "h w"]
    boxes: Float16[Tensor, "D h w"]
    view: View


class Clean:
    """The clean outputs of a scene, perceived when they are first asked for: `logits[t]`, `boxes[t]`, `views[t]`."""

    def __init__(self, frames: PerFrame[CleanFrame]) -> None:
        self.logits = PerFrame(len(frames), lambda t: frames[t].logits, keep=False)
        self.boxes = PerFrame(len(frames), lambda t: frames[t].boxes, keep=False)
        self.views = PerFrame(len(frames), lambda t: frames[t].view, keep=False)


@dataclass(frozen=True, eq=False)
class Episode:
    """One scene as N vehicles sense it: maps 0..n-1 are the first n connected vehicles', the road-side unit's the last.

    The ego frame of frame t is the grid frame of map 0 at t. What is a `PerFrame` is computed for a frame when it is
    first asked for; so are the maps, which the store then keeps.
    """

    scene: Scene
    store: MapStore
    agents: tuple[int, ...]  # rows of a frame's sweeps
    ego_T_sender: Float[Tensor, "T N 3"]  # m, m, rad
    coverage: Float[Tensor, "T N H W"]
    clean: Clean  # everyone fused, no attack; half precision
    truth: PerFrame[Float[np.ndarray, "_ 5"]]  # strict: every vehicle in range, seen or hidden; ego frame
    ego_context: PerFrame[Shaped[np.ndarray, "..."]] | None = None  # of the ego, if the detector uses it
    witnesses: PerFrame[Int[np.ndarray, " L"]] | None = None  # single views that find each vehicle of the truth

    @property
    def clean_views(self) -> PerFrame[View]:
        """The ego's view of each frame without an attack."""
        return self.clean.views

    def maps(self, name: str, frame: int) -> Float[Tensor, "N C H W"]:
        """`features` or `received` of one frame, single precision, on the CPU."""
        return stack_maps([(self, frame)], name)[0].float().cpu()

    def encode(self) -> None:
        """Encode now every frame that is not stored, for whoever plays the scene later."""
        for frame in range(0, self.scene.n_frames, BLOCK):
            self.store.maps(self.scene, self.agents, frame)
            if self.ego_context is not None:
                self.store.ego_context(self.scene, frame)


def stack_maps(
    places: Sequence[tuple[Episode, int]], name: str, out: Float[Tensor, "E N C H W"] | None = None
) -> Float[Tensor, "E N C H W"]:
    """Maps of E (episode, frame), on the detector's device.

    Args:
        places: the episodes and frames; all with the same N.
        name: "features", f_E of each sweep in the sender's grid frame; or "received", the same warped to the ego frame.
        out: where to write them; a new tensor by default, nobody else's.

    Returns:
        `out`.
    """
    if name not in ("features", "received"):
        raise ValueError(f'maps are "features" or "received", not {name!r}')
    stacked = empty_maps(places) if out is None else out
    first, n_maps = places[0][0].store.detector, len(places[0][0].agents)
    read = (episode.store.maps(episode.scene, episode.agents, frame) for episode, frame in places)
    maps = [torch.from_numpy(one) for of_frame in read for one in of_frame]
    if name == "received":
        poses = torch.cat([episode.ego_T_sender[frame] for episode, frame in places])
        received.write(first, stacked.flatten(0, 1), range(len(maps)), maps, poses, together=n_maps)
    else:
        for row, one in zip(stacked.flatten(0, 1), maps, strict=True):
            row.copy_(one)
    return stacked


def empty_maps(places: Sequence[tuple[Episode, int]]) -> Float[Tensor, "E N C H W"]:
    """Room for the maps of E (episode, frame), on the detector's device."""
    detector, n_maps = places[0][0].store.detector, len(places[0][0].agents)
    shape = (len(places), n_maps, detector.channels, detector.size, detector.size)
    return torch.empty(shape, device=detector.device, dtype=dtype_of(detector))


@torch.no_grad()
def warp_frame(
    detector: DetectorLike, maps: Sequence[Float16[np.ndarray, "C H W"]], ego_T_sender: Float[Tensor, "N 3"]
) -> Float[Tensor, "N C H W"]:
    """One frame's maps in the ego frame, on the detector's device."""
    rows = torch.empty(len(maps), *maps[0].shape, device=detector.device, dtype=dtype_of(detector))
    received.write(detector, rows, range(len(maps)), [torch.from_numpy(one) for one in maps], ego_T_sender)
    return rows


def stack_ego_context(
    places: Sequence[tuple[Episode, int]], device: torch.device | str = "cpu"
) -> Shaped[Tensor, "E ..."] | None:
    """The ego context of E (episode, frame); None if the detector uses none."""
    rows = [episode.ego_context[frame] for episode, frame in places if episode.ego_context is not None]
    return torch.from_numpy(np.stack(rows)).to(device) if rows else None


def ego_place(scene: Scene, frame: int) -> Float[np.ndarray, " 2"]:
    """Where the ego stands in the world; m."""
    return scene.pose[frame, scene.connected[0], :2]


def ego_heading(scene: Scene, frame: int) -> float:
    """Which way the ego faces in the world; rad."""
    return float(scene.pose[frame, scene.connected[0], 2])


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
    stood = np.stack(places)
    origins = grid_origin(stood)
    score_maps = dense.scores.detach().cpu().numpy()
    return [
        View(group, frame, origin, found, found.above(detector.threshold), score_map)
        for group, frame, origin, found, score_map in zip(
            groups, frames, origins, detector.detect(dense, stood - origins), score_maps, strict=True
        )
    ]
