"""What the liars of one frame want."""

from __future__ import annotations

from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from cp_env.detector.adversarial import adversarial_loss
from cp_env.detector.decoder import Dense


@dataclass(frozen=True)
class Objective:
    """Weights of the three parts of `adversarial_loss`, PRBI Eq. (2): conceal, invent, displace."""

    hide: float = 1.0
    spoof: float = 1.0
    drift: float = 1.0

    def __call__(self, dense: Dense, clean: Dense) -> Float[Tensor, " B"]:
        return adversarial_loss(dense, clean, hide=self.hide, spoof=self.spoof, drift=self.drift)
