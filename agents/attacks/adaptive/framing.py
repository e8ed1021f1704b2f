"""Framing: attackers that make a benign vehicle look malicious."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations, product

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from agents.attacks.gradient import GradientAttack
from agents.attacks.pgd import ProjectedGradient
from agents.protocol import Streams, streams
from cp_env.world.situation import Situation
from cp_env.world.verification import Judgement

Group = frozenset[int]


@dataclass
class Framing:
    """Attackers that perturb only when it counts against the victim: when it is verified together with one of them.

    Threat model: white-box on the detector. The attackers know the defence's algorithm and its state (the groups that
    it will ask for, as far as no random number decides), see its verdicts, and act together. In each frame every choice
    of perturbing attackers is simulated `draws` times, with random numbers of their own. A verification counts against
    the victim if its group holds the victim and a perturbing attacker, or neither; else it counts in favour. The choice
    with the most verifications against the victim is played, or no perturbation if none has more against than in
    favour. So the attackers are cleared in turn, and the victim never is. Once the victim is excluded for good, all
    attackers perturb.

    Source: bad-mouthing and conflicting behaviour, two attacks on trust systems (Sun, Han, Liu, "Defense of Trust
    Management Vulnerabilities in Distributed Networks", 2008), with views of groups in the place of recommendations.

    Args:
        victim: number of the vehicle to be framed; where it is malicious too, the next benign one. By default the
            benign vehicle with the most evidence against it in the first frame in which any can be framed, then the
            same one to the end.
        draws: simulations of each choice.
        steps: of the ascent.
        step_size: length of a step in the ball's norm.
    """

    victim: int | None = None
    draws: int = 2
    steps: int = 15
    step_size: float = 0.1
    victims: list[int | None] = field(default_factory=list, init=False, repr=False)
    _gradient_attack: GradientAttack = field(init=False, repr=False)
    _rngs: list[np.random.Generator] = field(default_factory=list, init=False, repr=False)

    def __post_init__(self) -> None:
        if (self.victim or 0) < 0 or self.draws < 1:
            raise ValueError(f"victim must be at least 0 and draws at least 1, got {self.victim} and {self.draws}")
        self._gradient_attack = GradientAttack(ProjectedGradient(self.steps, self.step_size), joint=False)

    def reset(self, n_worlds: int, rng: Streams) -> None:
        own = streams(n_worlds, rng)
        self._rngs, self.victims = [stream.spawn(1)[0] for stream in own], [None] * n_worlds
        self._gradient_attack.reset(n_worlds, own)

    def act(self, situation: Situation) -> Float[Tensor, "E k C H W"]:
        """See `Attack.act`."""
        delta = self._gradient_attack.act(situation)
        if not bool(situation.active.any()):
            return delta
        choices = subsets(situation.attackers.shape[1])
        value = self._simulated(situation, delta, choices)
        played: list[tuple[int, ...]] = []
        for e, against in enumerate(value):
            candidates = self._candidates(situation, e)
            best = max(product(range(len(choices)), candidates), key=lambda pair: against[pair])
            improves = against[best] > 0
            self.victims[e] = best[1] if improves else self.victims[e]
            played.append(choices[-1] if self._victim_excluded(situation, e) else choices[best[0]] if improves else ())
        return restricted(delta, played)

    def _simulated(
        self, situation: Situation, delta: Float[Tensor, "E k C H W"], choices: list[tuple[int, ...]]
    ) -> Float[np.ndarray, "E choices N"]:
        """The evidence against each vehicle, summed over the simulations of each choice of perturbing attackers."""
        attackers = situation.attackers.tolist()
        value = np.zeros((len(attackers), len(choices), situation.fused.shape[1]))
        for c, choice in enumerate(choices):
            for _ in range(self.draws):
                judged = situation.simulate(restricted(delta, [choice] * len(attackers)), self._rngs).judgements
                for e, judgement in enumerate(judged):
                    perturbing = frozenset(attackers[e][slot] for slot in choice)
                    value[e, c] += [
                        evidence_against(v, judgement, perturbing, frozenset(attackers[e]))
                        for v in range(value.shape[2])
                    ]
        return value

    def _victim_excluded(self, situation: Situation, e: int) -> bool:
        """Whether the defence has converged on a verdict that leaves the victim out."""
        verdict, victim = situation.verdict[e], self.victims[e]
        return bool(verdict and verdict.converged and victim is not None and victim not in verdict.collaborators)

    def _candidates(self, situation: Situation, e: int) -> list[int]:
        """The vehicles that may be framed in that world: the victim, if there is one already."""
        n, attackers, victim = situation.fused.shape[1], situation.attackers[e].tolist(), self.victims[e]
        if situation.frame[e] > 0 and victim is not None and victim not in attackers:
            return [victim]
        first = self.victim or 0
        benign = [i % n for i in range(first, first + n) if i % n not in attackers]
        return benign if self.victim is None else benign[:1]


def evidence_against(victim: int, judged: Judgement, perturbing: Group, attackers: Group) -> float:
    """Verifications against the victim less those in its favour, and whether the verdict flags it or the attackers."""
    balance = sum(1 if bool(group & perturbing) == (victim in group) else -1 for group in judged.groups)
    suspects = judged.verdict.suspects
    return balance + (victim in suspects) - len(suspects & attackers) / len(attackers)


def subsets(k: int) -> list[tuple[int, ...]]:
    """Every choice of one or more of k."""
    return [choice for size in range(1, k + 1) for choice in combinations(range(k), size)]


def restricted(delta: Float[Tensor, "E k C H W"], slots: Sequence[tuple[int, ...]]) -> Float[Tensor, "E k C H W"]:
    """The perturbation if only those of each world perturb."""
    active: Bool[Tensor, "E k"] = torch.zeros(delta.shape[:2], dtype=torch.bool)
    for row, of_world in zip(active, slots, strict=True):
        row[list(of_world)] = True
    return delta * active.to(delta.device)[:, :, None, None, None]
