"""The standard detection loss as an objective: what trains the detector is what the attack maximises, PRBI Eq. (2).

The paper's L_det is "the multi-agent standard detection loss" of J. Tu and others, "Adversarial Attacks on Multi-Agent
Communication" (ICCV 2021): classification and regression of the output against a target. An attacker knows no ground
truth, so the target is what the ego would have seen without the attack, its boxes at the operating threshold. The
parts are those of `cp_env.detector.training.loss`: penalty-reduced focal loss and smooth L1 of the boxes.

Beside `both` this loss has no margin: a ghost of probability 0.99 pays as much for one more logit as one of 0.5. And
every background cell counts for itself, so it is the easiest cells that gain most.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from agents.attacks.targets import AttackTargets, ViewLoss
from cp_env.detector.model.decoder import Dense
from cp_env.detector.training.loss import Targets, detection_loss
from cp_env.detector.training.loss import targets as decoder_targets
from cp_env.world.counterfactual import clean_views
from cp_env.world.situation import Situation


@dataclass(frozen=True)
class DetectionLoss:
    """Classification and regression loss of each view against the unattacked output's boxes.

    Args:
        classification: weight of the focal loss of the score map.
        regression: weight of the smooth L1 loss of the boxes, in units of the training's own weight.

    Raises:
        ValueError: a weight that is negative, or none above zero.
    """

    classification: float = 1.0
    regression: float = 1.0

    def __post_init__(self) -> None:
        weights = self.classification, self.regression
        if not all(weight >= 0 for weight in weights) or not any(weights):
            raise ValueError(
                "detection_loss takes a weight of the classification and of the regression, at least 0 and not both 0; "
                f"got {self.classification} and {self.regression}"
            )

    def __call__(self, targets: AttackTargets) -> ViewLoss:
        device = targets.groups.device
        worlds = [drawn.to(device) for drawn in unattacked_targets(targets.situation)]
        wanted = [worlds[row] for row in targets.rows.tolist()]

        def view_loss(dense: Dense) -> Float[Tensor, " B"]:
            views = (Dense(dense.logits[b, None], dense.boxes[b, None]) for b in range(len(wanted)))
            return torch.stack([self._of(view, drawn) for view, drawn in zip(views, wanted, strict=True)])

        return view_loss

    def _of(self, view: Dense, wanted: Targets) -> Float[Tensor, ""]:
        """The weighted loss of one view."""
        if self.classification == self.regression:
            return self.classification * detection_loss(view, wanted)
        still = Dense(view.logits, wanted.boxes)  # no box has moved: the classification alone
        classified = detection_loss(still, wanted)
        return self.classification * classified + self.regression * (detection_loss(view, wanted) - classified)


def unattacked_targets(situation: Situation) -> list[Targets]:
    """The boxes that each world's ego would have seen without an attack, as the decoder's targets; on the CPU."""
    extent, size = situation.detector.extent, situation.clean.logits.shape[-1]
    drawn = []
    for view in clean_views(situation):
        boxes = torch.from_numpy(view.seen.boxes.copy())
        drawn.append(decoder_targets(boxes, torch.ones(1, len(boxes), dtype=torch.bool), size, extent))
    return drawn
