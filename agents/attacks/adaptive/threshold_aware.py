"""The defender in the loop: as much damage as the threshold lets through."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from agents.attacks.adaptive.eot import drawn_from
from agents.attacks.gradient import Ascent
from agents.attacks.objectives.scene_target import Boxes, Picture, alone, both, crossings, remembered
from agents.attacks.pgd import Steepest
from agents.attacks.targets import Audience, fused
from agents.protocol import Streams
from cp_env.types import View
from cp_env.world.counterfactual import Pair, alike, damage, foresee, honest
from cp_env.world.situation import Situation

REFERENCES: dict[str, Boxes] = {"output": remembered, "ego": alone}


@dataclass
class InLoop:
    """Liars who know what the defence compares, and its threshold: they never let it see anything below.

    Threat model: white-box on the detector, and told ε (PRBI's 0.35 for everyone's view against the ego's last output;
    0.3 against what the ego sees alone, for ROBOSAC and PASAC) but not the coins. Source: the defence is part of what
    the attack optimises, as Carlini and Wagner ("Adversarial Examples Are Not Easily Detected", 2017) and Tramèr et al.
    ("On Adaptive Attacks to Adversarial Example Defenses", 2020) ask for. The Jaccard has no gradient, so the surrogate
    is a picture (`agents.attacks.objectives.scene_target`): two ascents look for the δ that shows the reference once
    more, and for the one that shows ghosts alone. Of `rungs` mixtures of the two, decoded and compared by the Jaccard
    itself, the most damaging is sent whose similarity is at least `threshold + margin`; the most similar of all if none
    reaches that.

    reference   "output": the ego's last output; "ego": its own view of this frame
    groups      whose views keep the promise: "fused", those the ego is expected to fuse; or every group of
                `agents.attacks.adaptive.eot`
                with a liar in it ("teams", "halves", "splits", with `size`), in expectation of which the ascents run
    threshold   ε
    margin      how far the similarity stays above it
    spacing     of the ghosts, m
    rungs       mixtures tried
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
    _audience: Audience = field(init=False, repr=False)
    _hold: Ascent = field(init=False, repr=False)
    _harm: Ascent = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if self.reference not in REFERENCES:
            raise ValueError(f"reference must be one of {', '.join(REFERENCES)}, got {self.reference!r}")
        if not 0 <= self.threshold <= self.threshold + self.margin <= 1 or self.rungs < 2:
            raise ValueError(
                "threshold and threshold + margin must lie in [0, 1] and rungs be at least 2; got "
                f"{self.threshold}, {self.margin} and {self.rungs}"
            )
        self._audience = fused if self.groups == "fused" else drawn_from(self.groups, self.size)
        held, ghosts = REFERENCES[self.reference], crossings(self.spacing)
        pictures = held, both(held, ghosts) if self.reference == "ego" else ghosts
        search = Steepest(self.steps, self.step_size)
        self._hold, self._harm = (
            Ascent(search, random_start=False, objective=Picture(picture), audience=self._audience)
            for picture in pictures
        )

    def reset(self, n_worlds: int, rng: Streams) -> None:
        self._hold.reset(n_worlds, rng)
        self._harm.reset(n_worlds, rng)

    def act(self, situation: Situation) -> Float[Tensor, "E k C H W"]:
        """See `Attacker.act`."""
        hold, harm = self._hold.act(situation), self._harm.act(situation)
        mixtures = [hold + share * (harm - hold) for share in np.linspace(0, 1, self.rungs).tolist()]
        pairs, clean = self._looked_at(situation), honest(situation)
        if not pairs:  # no view has a liar in it: nothing that is sent matters
            return hold
        value = np.stack([self._value(situation, delta, pairs, clean) for delta in mixtures])
        best = torch.from_numpy(value.argmax(axis=0)).to(hold.device)
        return torch.stack(mixtures)[best, torch.arange(len(best), device=hold.device)]

    def _looked_at(self, situation: Situation) -> list[Pair]:
        """The groups with a liar in them, each with its world."""
        groups, weights = (part.cpu() for part in self._audience(situation))
        liars = [frozenset(of_world) for of_world in situation.attackers.tolist()]
        named = [(e, frozenset(groups[e, s].nonzero().flatten().tolist())) for e, s in weights.nonzero().tolist()]
        return [(e, group) for e, group in named if group & liars[e]]

    def _value(
        self, situation: Situation, delta: Float[Tensor, "E k C H W"], pairs: list[Pair], clean: list[View]
    ) -> Float[np.ndarray, " E"]:
        """What δ is worth in each world: above 2 if all its views keep the promise, by their mean damage; below, by the
        least similarity."""
        views, worlds = foresee(situation, delta, pairs), [e for e, _ in pairs]
        references: list[View | None] = list(situation.output)
        if self.reference == "ego":
            references = [*foresee(situation, delta, [(e, frozenset({0})) for e in range(len(delta))])]
        likeness, harmed, looks = np.ones(len(delta)), np.zeros(len(delta)), np.bincount(worlds, minlength=len(delta))
        np.minimum.at(likeness, worlds, alike(views, [references[e] for e in worlds]))
        np.add.at(harmed, worlds, damage(views, [clean[e] for e in worlds]))
        kept = likeness >= self.threshold + self.margin
        return np.where(kept, 2 + harmed / np.maximum(looks, 1), likeness)
