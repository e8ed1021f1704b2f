"""The action map `critical`: `stealth` with an aim that turns with the ego, for attacks on what its driving needs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Float

from cp_env.envs.actions.guided import Guidance
from cp_env.envs.actions.similarity_bounded import SimilarityBounded
from cp_env.world.situation import Situation

MIDDLE = (1.0, -1.0, -1.0, 0.0, 0.0, -0.5, 1.0, 0.5)
"""What 0 means as a guided action: hide only, 8 m wide, by all of Δ and from the last δ on."""

AHEAD = 8.0
"""Where 0 aims: about two cars ahead of the ego's centre; m."""

SPAN = 16.0
"""How far an aim of 1 is from that of 0; m. What is critical is near, so an aim is finer than that of `stealth`."""


class LaneAimed(SimilarityBounded):
    """The nine numbers of `stealth`, with an aim that is near, and turns with the ego.

    Vehicles that are critical drive before the ego or cross its way. In a frame of fixed axes a policy would have to
    follow each turn of the ego to aim there; here one aim fits every street. What is critical is missed only if it is
    hidden. So 0, the middle of all nine, hides what is ahead, and neither spoofs nor moves boxes. The ego's heading is
    known to all who send to it. Our choice: what `agents.attacks.leader.nearest_removal` does by a rule, for learners.
    """

    middle = MIDDLE

    def _guidance(self, steering: Float[np.ndarray, "E k 8"], situation: Situation) -> Guidance:
        guidance = super()._guidance(steering, situation)
        place = torch.from_numpy(steering[..., 3:5]).to(guidance.x) * SPAN
        heading = torch.from_numpy(situation.heading).to(guidance.x)[:, None]
        ahead, left = AHEAD + place[..., 0], place[..., 1]
        return replace(
            guidance,
            x=ahead * heading.cos() - left * heading.sin(),
            y=ahead * heading.sin() + left * heading.cos(),
        )
