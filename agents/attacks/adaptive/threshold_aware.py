"""The threshold-aware attack: as much damage as the threshold of the defence lets through."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from agents.attacks.adaptive.eot import drawn_from
from agents.attacks.gradient import GradientAttack
from agents.attacks.objectives.scene_target import Boxes, SceneTarget, ego_view, last_output, lattice_ghosts, merged
from agents.attacks.pgd import ProjectedGradient
from agents.attacks.targets import TargetGroups, fused
from agents.protocol import Streams
from cp_env.types import View
from cp_env.world.counterfactual import Pair, clean_views, damage, similarities, views_under
from cp_env.world.situation import Situation

REFERENCES: dict[str, Boxes] = {"output": last_output, "ego": ego_view}


@dataclass
class InLoop:
    """Attackers that know what the defence compares, and its threshold: no view falls below it.

    Threat model: white-box on the detector. The attackers know ε (PRBI's 0.35 for everyone's view against the ego's
    last output; 0.3 against what the ego sees alone, for ROBOSAC and PASAC) but not the random numbers. Source: the
    defence is part of what the attack optimises, as Carlini and Wagner ("Adversarial Examples Are Not Easily Detected",
    2017) and Tramèr et al. ("On Adaptive Attacks to Adversarial Example Defenses", 2020) ask for. The Jaccard has no
    gradient, so the surrogate is a target scene (`agents.attacks.objectives.scene_target`): two ascents search for the
    δ that shows the reference once more, and for the one that shows ghosts alone. `rungs` mixtures of the two are
    decoded and compared by the Jaccard itself. The most damaging one is sent whose similarity is at least `threshold +
    margin`; the most similar one if none reaches that.

    Args:
        threshold: ε.
        margin: how far the similarity stays above ε.
        reference: "output", the ego's last output; or "ego", its own view of this frame.
        groups: the groups whose views stay above ε. "fused": those the ego is expected to fuse. "teams", "halves" or
            "splits" (with `size`): every such group with an attacker in it, see `agents.attacks.adaptive.eot`; the
            ascents run in expectation over them.
        size: of a group, where it has one.
        spacing: of the ghosts, m.
        rungs: mixtures tried.
        steps: of each ascent.
        step_size: length of a step in the ball's norm.
    """

    threshold: float = 0.35
    margin: float = 0.02
    reference: str = "output"
    groups: str = "fused"
    size: int = 3
    spacing: float = 12.0
    rungs: int = 8
    steps: int = 15
    step_size: float = 0.1
    _target_groups: TargetGroups = field(init=False, repr=False)
    _hold: GradientAttack = field(init=False, repr=False)
    _harm: GradientAttack = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if self.reference not in REFERENCES:
            raise ValueError(f"reference must be one of {', '.join(REFERENCES)}, got {self.reference!r}")
        if not 0 <= self.threshold <= self.threshold + self.margin <= 1 or self.rungs < 2:
            raise ValueError(
                "threshold and threshold + margin must lie in [0, 1] and rungs be at least 2; got "
                f"{self.threshold}, {self.margin} and {self.rungs}"
            )
        self._target_groups = fused if self.groups == "fused" else drawn_from(self.groups, self.size)
        reference_boxes, ghosts = REFERENCES[self.reference], lattice_ghosts(self.spacing)
        scenes = reference_boxes, merged(reference_boxes, ghosts) if self.reference == "ego" else ghosts
        optimizer = ProjectedGradient(self.steps, self.step_size)
        self._hold, self._harm = (
            GradientAttack(
                optimizer, random_start=False, objective=SceneTarget(scene), target_groups=self._target_groups
            )
            for scene in scenes
        )

    def reset(self, n_worlds: int, rng: Streams) -> None:
        self._hold.reset(n_worlds, rng)
        self._harm.reset(n_worlds, rng)

    def act(self, situation: Situation) -> Float[Tensor, "E k C H W"]:
        """See `Attack.act`."""
        hold, harm = self._hold.act(situation), self._harm.act(situation)
        mixtures = [hold + share * (harm - hold) for share in np.linspace(0, 1, self.rungs).tolist()]
        pairs, clean = self._target_pairs(situation), clean_views(situation)
        if not pairs:  # no view has an attacker in it: nothing that is sent matters
            return hold
        judged = [self._judged(situation, delta, pairs, clean) for delta in mixtures]
        similarity, losses = (np.stack(part) for part in zip(*judged, strict=True))
        kept = similarity >= self.threshold + self.margin
        chosen = np.where(kept.any(axis=0), np.where(kept, losses, -1.0).argmax(axis=0), similarity.argmax(axis=0))
        best = torch.from_numpy(chosen).to(hold.device)
        return torch.stack(mixtures)[best, torch.arange(len(best), device=hold.device)]

    def _target_pairs(self, situation: Situation) -> list[Pair]:
        """The groups with an attacker in them, each with its world."""
        groups, weights = (part.cpu() for part in self._target_groups(situation))
        attackers = [frozenset(of_world) for of_world in situation.attackers.tolist()]
        named = [(e, frozenset(groups[e, s].nonzero().flatten().tolist())) for e, s in weights.nonzero().tolist()]
        return [(e, group) for e, group in named if group & attackers[e]]

    def _judged(
        self, situation: Situation, delta: Float[Tensor, "E k C H W"], pairs: list[Pair], clean: list[View]
    ) -> tuple[Float[np.ndarray, " E"], Float[np.ndarray, " E"]]:
        """The lowest similarity of each world's views under δ to their reference, and their mean damage."""
        views, worlds = views_under(situation, delta, pairs), [e for e, _ in pairs]
        references: list[View | None] = list(situation.output)
        if self.reference == "ego":
            references = [*views_under(situation, delta, [(e, frozenset({0})) for e in range(len(delta))])]
        similarity, harmed = np.ones(len(delta)), np.zeros(len(delta))
        counts = np.bincount(worlds, minlength=len(delta))
        np.minimum.at(similarity, worlds, similarities(views, [references[e] for e in worlds]))
        np.add.at(harmed, worlds, damage(views, [clean[e] for e in worlds]))
        return similarity, harmed / np.maximum(counts, 1)
