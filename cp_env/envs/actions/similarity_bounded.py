"""An action map for liars who mind what the ego saw last: guided ascent, held back until its view stays similar."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from cp_env.envs.actions.guided import Guided
from cp_env.world.counterfactual import alike, foresee
from cp_env.world.situation import Situation

SHIFTED = (0, 5, 6)  # strength, width and persistence: 0 is the end of the range, not the middle
GATE = 7
RUNGS = 6


def read(actions: Float[np.ndarray, "*b 9"]) -> tuple[Float[np.ndarray, "*b 8"], Float[np.ndarray, "*b"]]:
    """The guided action in a quiet one, and the floor."""
    steering = actions[..., :8].copy()
    steering[..., SHIFTED] += 1
    steering[..., GATE] += 0.5
    return np.clip(steering, -1, 1), (1 - actions[..., 8]) / 2


class Quiet(Guided):
    """Nine numbers: those of `guided`, and a floor under the similarity of the ego's view to its last output.

    The ascent gives the δ that the liars would like to send. Sent is the mixture of that and of their last δ, of
    `RUNGS`, that goes furthest and whose view of those whom the ego is expected to fuse is still similar, Eq. (5), to
    the ego's last output by the floor, +1 … -1 being 0 … 1; or else the one that is most similar. So 0, the middle of
    all nine, is an attack of full strength that keeps half of what was seen; strength, aim's width and persistence
    have their ends there, and the gate shuts below -0.5. Liars share the mean of their floors. Our choice: what
    `agents.attacks.adaptive.threshold_aware` does by a rule, for learners.
    """

    size = 9

    def __call__(self, actions: Float[np.ndarray, "E k *a"], situation: Situation) -> Float[Tensor, "E k C H W"]:
        steering, floors = read(actions)
        device, floor = situation.received.device, torch.from_numpy(floors.mean(axis=1))
        before = self._carried(situation)
        wanted = super().__call__(steering, situation)
        fires = wanted.flatten(2).any(2)[..., None, None, None]
        start = before * fires  # who pauses sends nothing
        rungs = [start + share * (wanted - start) for share in np.linspace(1, 0, RUNGS).tolist()]
        pairs = [(e, frozenset(row.nonzero().flatten().tolist())) for e, row in enumerate(situation.fused.cpu())]
        found = [alike(foresee(situation, delta, pairs), list(situation.output)) for delta in rungs]
        likeness = torch.from_numpy(np.stack(found))
        kept = likeness >= floor
        best = torch.where(kept.any(0), kept.float().argmax(0), likeness.argmax(0)).to(device)
        sent = torch.stack(rungs)[best, torch.arange(len(best), device=device)]
        self._last = torch.where(fires, sent, before)
        return sent
