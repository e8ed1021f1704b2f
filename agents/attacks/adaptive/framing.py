"""Framing: liars who make an innocent look guilty."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations, product

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from agents.attacks.gradient import Ascent
from agents.attacks.pgd import Steepest
from agents.protocol import Streams, streams
from cp_env.world.situation import Situation
from cp_env.world.verification import Judgement

Group = frozenset[int]


@dataclass
class Framing:
    """Liars who lie only when it will be held against the victim: when it is looked at together with one who lies.

    Threat model: white-box on the detector; the liars know the defence's algorithm and its state (whom it will group
    with whom, as far as no coin decides), see its verdicts, and act together. In each frame every choice of who lies is
    rehearsed `draws` times, with coins of their own. A look speaks against the victim if it holds the victim and one
    who lies, or neither; else for it. The choice of which most looks speak against it is played, silence if none does.
    So the liars are cleared in turn, and the victim never is. Once it is convicted for good, all lie.

    Source: bad-mouthing and conflicting behaviour, two attacks on trust systems (Sun, Han, Liu, "Defense of Trust
    Management Vulnerabilities in Distributed Networks", 2008), with views of groups in the place of recommendations.

    victim  the number of who is to be framed; where that one lies too, the next who does not. By default the innocent
            whom chance favours least, in the first frame in which any can be framed; then the same to the end
    draws   rehearsals of a choice
    """

    victim: int | None = None
    draws: int = 2
    steps: int = 15
    step_size: float = 0.1
    victims: list[int | None] = field(default_factory=list, init=False, repr=False)
    _ascent: Ascent = field(init=False, repr=False)
    _coins: list[np.random.Generator] = field(default_factory=list, init=False, repr=False)

    def __post_init__(self) -> None:
        if (self.victim or 0) < 0 or self.draws < 1:
            raise ValueError(f"victim must be at least 0 and draws at least 1, got {self.victim} and {self.draws}")
        self._ascent = Ascent(Steepest(self.steps, self.step_size), joint=False)

    def reset(self, n_worlds: int, rng: Streams) -> None:
        own = streams(n_worlds, rng)
        self._coins, self.victims = [stream.spawn(1)[0] for stream in own], [None] * n_worlds
        self._ascent.reset(n_worlds, own)

    def act(self, situation: Situation) -> Float[Tensor, "E k C H W"]:
        """See `Attacker.act`."""
        lie = self._ascent.act(situation)
        if not bool(situation.active.any()):
            return lie
        choices = subsets(situation.attackers.shape[1])
        value = self._rehearsed(situation, lie, choices)
        played: list[tuple[int, ...]] = []
        for e, against in enumerate(value):
            candidates = self._candidates(situation, e)
            best = max(product(range(len(choices)), candidates), key=lambda pair: against[pair])
            worthwhile = against[best] > 0
            self.victims[e] = best[1] if worthwhile else self.victims[e]
            played.append(choices[-1] if self._convicted(situation, e) else choices[best[0]] if worthwhile else ())
        return chosen(lie, played)

    def _rehearsed(
        self, situation: Situation, lie: Float[Tensor, "E k C H W"], choices: list[tuple[int, ...]]
    ) -> Float[np.ndarray, "E choices N"]:
        """What speaks against each vehicle, summed over the rehearsals of each choice of who lies."""
        liars = situation.attackers.tolist()
        value = np.zeros((len(liars), len(choices), situation.fused.shape[1]))
        for c, choice in enumerate(choices):
            for _ in range(self.draws):
                judged = situation.rehearse(chosen(lie, [choice] * len(liars)), self._coins).judgements
                for e, judgement in enumerate(judged):
                    lying = frozenset(liars[e][slot] for slot in choice)
                    value[e, c] += [
                        held_against(v, judgement, lying, frozenset(liars[e])) for v in range(value.shape[2])
                    ]
        return value

    def _convicted(self, situation: Situation, e: int) -> bool:
        """Whether the defence has converged on a verdict that leaves the victim out."""
        verdict, victim = situation.verdict[e], self.victims[e]
        return bool(verdict and verdict.converged and victim is not None and victim not in verdict.collaborators)

    def _candidates(self, situation: Situation, e: int) -> list[int]:
        """Who may be framed in that world: the victim, if there is one already."""
        n, liars, held = situation.fused.shape[1], situation.attackers[e].tolist(), self.victims[e]
        if situation.frame[e] > 0 and held is not None and held not in liars:
            return [held]
        first = self.victim or 0
        innocent = [i % n for i in range(first, first + n) if i % n not in liars]
        return innocent if self.victim is None else innocent[:1]


def held_against(victim: int, judged: Judgement, lying: Group, liars: Group) -> float:
    """How many more looks speak against the victim than for it, and what the verdict says of it and of the liars."""
    looks = sum(1 if bool(group & lying) == (victim in group) else -1 for group in judged.groups)
    suspects = judged.verdict.suspects
    return looks + (victim in suspects) - len(suspects & liars) / len(liars)


def subsets(k: int) -> list[tuple[int, ...]]:
    """Every choice of one or more of k."""
    return [choice for size in range(1, k + 1) for choice in combinations(range(k), size)]


def chosen(delta: Float[Tensor, "E k C H W"], slots: Sequence[tuple[int, ...]]) -> Float[Tensor, "E k C H W"]:
    """What is sent if only those of each world's liars lie."""
    speaks: Bool[Tensor, "E k"] = torch.zeros(delta.shape[:2], dtype=torch.bool)
    for row, of_world in zip(speaks, slots, strict=True):
        row[list(of_world)] = True
    return delta * speaks.to(delta.device)[:, :, None, None, None]
