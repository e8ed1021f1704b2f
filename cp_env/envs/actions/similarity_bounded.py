"""The action map `stealth`: guided ascent under a floor on the similarity to the ego's last output."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from cp_env.envs.actions.guided import Guided
from cp_env.world.counterfactual import similarities, views_under
from cp_env.world.situation import Situation

MIDDLE = (1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 0.5)
"""What 0 means as a guided action: the largest strength, width and persistence; the gate shuts below -0.5."""

RUNGS = 6


def read(
    actions: Float[np.ndarray, "*b 9"], middle: Sequence[float] = MIDDLE
) -> tuple[Float[np.ndarray, "*b 8"], Float[np.ndarray, "*b"]]:
    """The guided part of a `stealth` action, and the floor.

    Args:
        actions: nine numbers of each slot.
        middle: the guided action that the first eight mean at 0.

    Returns:
        The guided part and the floor.
    """
    steering = actions[..., :8] + np.array(middle, dtype=actions.dtype)
    return np.clip(steering, -1, 1), (1 - actions[..., 8]) / 2


class SimilarityBounded(Guided):
    """Nine numbers: those of `guided`, and a floor under the similarity of the ego's view to its last output.

    The ascent gives the δ that the attackers want. `RUNGS` mixtures of it and of their last δ are tried. Each is judged
    by the similarity, Eq. (5), of the view of the vehicles that the ego is expected to fuse to the ego's last output.
    Sent is the mixture that goes furthest and reaches the floor (+1 … -1 is 0 … 1), or else the most similar one. So 0,
    the middle of all nine, is an attack of full strength that keeps half of what was seen. Strength, the aim's width
    and persistence have their largest values there, and the gate shuts below -0.5. Attackers share the mean of their
    floors. Our choice: what `agents.attacks.adaptive.threshold_aware` does by a rule, for learners.
    """

    size = 9
    middle = MIDDLE

    def __call__(self, actions: Float[np.ndarray, "E k *a"], situation: Situation) -> Float[Tensor, "E k C H W"]:
        steering, floors = read(actions, self.middle)
        device, floor = situation.device, torch.from_numpy(floors.mean(axis=1))
        guidance = self._guidance(steering, situation)
        before, wanted = self._carried(situation), self._steered(guidance, situation)
        fires = wanted.flatten(2).any(2)[..., None, None, None]
        start = before * fires  # an attacker that pauses sends nothing
        rungs = [start + share * (wanted - start) for share in np.linspace(1, 0, RUNGS).tolist()]
        pairs = [(e, frozenset(row.nonzero().flatten().tolist())) for e, row in enumerate(situation.fused.cpu())]
        found = [similarities(views_under(situation, delta, pairs), list(situation.output)) for delta in rungs]
        similarity = torch.from_numpy(np.stack(found))
        passes = similarity >= floor
        best = torch.where(passes.any(0), passes.float().argmax(0), similarity.argmax(0)).to(device)
        sent = torch.stack(rungs)[best, torch.arange(len(best), device=device)]
        self._last = torch.where(fires, sent, before)
        return sent
