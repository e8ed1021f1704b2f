"""Expectation over transformation: attacks on the groups that a randomised defence may verify."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from agents.attacks.gradient import GradientAttack, no_perturbation
from agents.attacks.pgd import ProjectedGradient
from agents.attacks.targets import GroupDistribution, TargetGroups
from agents.protocol import Streams, streams
from cp_env.world.situation import Situation

Groups = list[frozenset[int]]


@dataclass
class Eot:
    """An attack in expectation on every group that the defence may fuse, and not only on everyone.

    Threat model: white-box on the detector. The attackers know the defence's algorithm but not its random numbers.
    Source: expectation over transformation (Athalye et al., "Synthesizing Robust Adversarial Examples", 2018), which
    they turn on randomised defences in "Obfuscated Gradients Give a False Sense of Security", 2018. The transformation
    here is the group that is fused.

    Args:
        groups: the groups in the expectation. "teams": the ego and `size - 1` of the others, ROBOSAC's, equally likely.
            "halves": the ego and one half of the others, PASAC's first depth, equally likely. "splits": `size` vehicles
            and, apart, the others, PRBI's two groups, equally likely. "simulated": the defence itself is simulated
            `draws` times against what was sent last, with random numbers of the attackers' own; each group that it
            asked for or fused counts as often.
        size: of "teams" and "splits".
        draws: simulations of the defence in a frame.
        steps: of the ascent.
        step_size: length of a step in the ball's norm.
        random_start: start from a random point of the ball, or from zero.
    """

    groups: str = "simulated"
    size: int = 3
    draws: int = 4
    steps: int = 15
    step_size: float = 0.1
    random_start: bool = True
    _gradient_attack: GradientAttack = field(init=False, repr=False)
    _rngs: list[np.random.Generator] = field(default_factory=list, init=False, repr=False)
    _last: Float[Tensor, "E k C H W"] | None = field(default=None, init=False, repr=False)

    def __post_init__(self) -> None:
        if self.size < 1 or self.draws < 1:
            raise ValueError(f"size and draws must be at least 1, got {self.size} and {self.draws}")
        optimizer = ProjectedGradient(self.steps, self.step_size)
        target_groups = self._simulated if self.groups == "simulated" else drawn_from(self.groups, self.size)
        self._gradient_attack = GradientAttack(optimizer, random_start=self.random_start, target_groups=target_groups)

    def reset(self, n_worlds: int, rng: Streams) -> None:
        own = streams(n_worlds, rng)
        self._rngs, self._last = [stream.spawn(1)[0] for stream in own], None
        self._gradient_attack.reset(n_worlds, own)

    def act(self, situation: Situation) -> Float[Tensor, "E k C H W"]:
        """See `Attack.act`."""
        self._last = self._gradient_attack.act(situation)
        return self._last

    def _simulated(self, situation: Situation) -> GroupDistribution:
        sent = no_perturbation(situation) if self._last is None else self._last
        asked: list[Groups] = [[] for _ in situation.fused]
        for _ in range(self.draws):
            for groups, judged in zip(asked, situation.simulate(sent, self._rngs).judgements, strict=True):
                groups += [*judged.groups, judged.verdict.collaborators]
        return group_distribution(situation, asked)


def teams(n: int, size: int) -> Groups:
    """The ego and `size - 1` of the others."""
    return [frozenset({0, *others}) for others in combinations(range(1, n), size - 1)]


def halves(n: int, size: int = 0) -> Groups:
    """The ego and a half of the others, the smaller or the larger, whatever `size` is."""
    del size
    sizes = {(n - 1) // 2, n - 1 - (n - 1) // 2}
    return [frozenset({0, *half}) for size in sorted(sizes) for half in combinations(range(1, n), size)]


def splits(n: int, size: int) -> Groups:
    """Any `size` vehicles, and the others."""
    first = [frozenset(group) for group in combinations(range(n), size)]
    return [*first, *(frozenset(range(n)) - group for group in first)]


GROUPS: dict[str, Callable[[int, int], Groups]] = {"teams": teams, "halves": halves, "splits": splits}
"""From the number of vehicles and a size to the groups that a defence draws from."""


def drawn_from(name: str, size: int) -> TargetGroups:
    """All groups of that name, equally likely.

    Args:
        name: "teams", "halves" or "splits".
        size: of a group, where it has one.

    Returns:
        The target groups.

    Raises:
        ValueError: an unknown name; and, when they are asked for, a size for which there are no groups.
    """
    if name not in GROUPS:
        raise ValueError(f"unknown groups {name!r}; known: {', '.join(GROUPS)}")

    def target_groups(situation: Situation) -> GroupDistribution:
        groups = GROUPS[name](situation.fused.shape[1], size)
        if not groups or not all(groups):
            raise ValueError(f"no {name} of size {size} among {situation.fused.shape[1]} vehicles; choose another size")
        return group_distribution(situation, [groups] * len(situation.fused))

    return target_groups


def group_distribution(situation: Situation, groups: Iterable[Groups]) -> GroupDistribution:
    """Target groups from the groups of each world, as far as they are present; one named twice counts twice."""
    named = [list(of_world) for of_world in groups]
    shape = len(named), max(len(of_world) for of_world in named), situation.fused.shape[1]
    members, weights = torch.zeros(shape, dtype=torch.bool), torch.zeros(shape[:2])
    for e, of_world in enumerate(named):
        distinct = list(dict.fromkeys(of_world))
        for s, group in enumerate(distinct):
            members[e, s, sorted(group)] = True
            weights[e, s] = of_world.count(group) / len(of_world)
    device = situation.fused.device
    members = members.to(device) & situation.present[:, None]
    return members, weights.to(device) * members.any(2)
