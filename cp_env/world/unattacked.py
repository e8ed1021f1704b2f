"""What the ego would make of a scene's frames without an attack."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int, Shaped
from torch import Tensor

from cp_env.detector.model.decoder import Dense
from cp_env.detector.protocol import with_ego_context
from cp_env.metrics import certified
from cp_env.types import Scene, View
from cp_env.world.episode import CleanFrame, ego_place, make_views, warp_frame
from cp_env.world.map_store import MapStore
from cp_env.world.per_frame import PerFrame


@dataclass(frozen=True, eq=False)
class Unattacked:
    """The frames of one scene, of which nobody sends a perturbation."""

    store: MapStore
    scene: Scene
    agents: tuple[int, ...]  # rows of a frame's sweeps
    ego_T_sender: Float[Tensor, "T N 3"]
    coverage: Float[Tensor, "T N H W"]
    ego_context: PerFrame[Shaped[np.ndarray, "..."]] | None

    def frame(self, t: int) -> CleanFrame:
        """The ego's output of frame t: the view of everyone."""
        dense, (view,) = self._views(t, [frozenset(range(len(self.agents)))])
        with torch.inference_mode(mode=False):  # whoever asks first, these are ordinary tensors
            return CleanFrame(dense.logits[0].half().cpu().clone(), dense.boxes[0].half().cpu().clone(), view)

    def witnesses(self, t: int, truth: Float[np.ndarray, "L 5"]) -> Int[np.ndarray, " L"]:
        """How many single views find each vehicle of the truth in frame t; see `cp_env.metrics.certified`."""
        _, views = self._views(t, [frozenset({i}) for i in range(len(self.agents))])
        return certified.witnesses([view.seen.boxes.astype(np.float64) for view in views], truth.astype(np.float64))

    def _views(self, t: int, groups: list[frozenset[int]]) -> tuple[Dense, list[View]]:
        """What groups see in frame t."""
        members = torch.tensor([[i in group for i in range(len(self.agents))] for group in groups])
        with torch.inference_mode():
            dense = self._perceived(t, members)
            place = ego_place(self.scene, t)
            return dense, make_views(self.store.detector, dense, groups, [t] * len(groups), [place] * len(groups))

    def _perceived(self, t: int, groups: Bool[Tensor, "B N"]) -> Dense:
        """The decoder's output of groups in frame t."""
        context = None if self.ego_context is None else torch.from_numpy(self.ego_context[t][None])
        detector, device = with_ego_context(self.store.detector, context), self.store.detector.device
        maps = self.store.maps(self.scene, self.agents, t)
        received = warp_frame(self.store.detector, maps, self.ego_T_sender[t])[None]
        world = torch.zeros(len(groups), dtype=torch.long, device=device)
        return detector.perceive(received, self.coverage[t : t + 1].to(device), world, groups.to(device))
