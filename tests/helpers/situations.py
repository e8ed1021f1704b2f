"""Situations without a world: random maps, random poses, a random detector."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import torch

from agents.attacks.objectives.untargeted import UntargetedObjective
from agents.attacks.targets import AttackTargets, Objective, TargetGroups, attack_loss, collect_targets, everyone
from cp_env.detector import Dense, Detector
from cp_env.detector.training.loss import Targets
from cp_env.types import Detections, View
from cp_env.world.situation import Situation
from cp_env.world.verification import Judgement
from defenders.protocol import Verdict

CHANNELS = 8
SIZE = 16  # cells, half the detector's own: a quarter of the work


def detector(seed: int = 0) -> Detector:
    """A small frozen detector whose random decoder is lively enough to be attacked; its maps are drawn, not encoded."""
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        model = Detector(channels=CHANNELS)
        model.size, model.map_size = SIZE, 2 * SIZE
        with torch.no_grad():
            model.decoder.head.weight.mul_(30.0)
            model.decoder.head.bias.zero_()
    model.encode = lambda sweeps: torch.zeros(len(sweeps), CHANNELS, SIZE, SIZE)  # type: ignore[method-assign]
    return model.freeze()


def situation(
    model: Detector, n_worlds: int = 2, n_attackers: int = 2, n_maps: int = 4, first: int = 0, **overrides: Any
) -> Situation:
    """Worlds `first`, `first + 1`, …: each is drawn from its own number alone."""
    worlds = [_world(e, n_attackers, n_maps) for e in range(first, first + n_worlds)]
    features, pose, attackers = (torch.stack(column) for column in zip(*worlds, strict=True))
    coverage, received = model.coverage(pose), model.warp(features, pose)
    everyone = torch.ones(n_worlds, n_maps, dtype=torch.bool)
    clean = model.perceive(received, coverage, torch.arange(n_worlds), everyone)
    made = Situation(
        features=lambda: features,
        receive=lambda: received,
        coverage=coverage,
        ego_T_sender=pose,
        perceive_clean=lambda: clean,
        attackers=attackers,
        fused=everyone,
        present=everyone,
        active=torch.ones(n_worlds, dtype=torch.bool),
        frame=np.full(n_worlds, 3),
        budget=0.3,
        norm="linf",
        detector=model,
        place=np.zeros((n_worlds, 2)),
        heading=np.zeros(n_worlds),
        output=(None,) * n_worlds,
        verdict=(None,) * n_worlds,
        simulate=simulate,
    )
    return replace(made, **overrides)


def targets(situation: Situation) -> AttackTargets:
    """Everyone's view, in every world."""
    return collect_targets(situation, everyone, torch.ones(len(situation.fused), dtype=torch.bool), joint=True)


def dense(drawn: Targets, logit: float = 6.0, elsewhere: float = -8.0) -> Dense:
    """A view that shows what is drawn."""
    return Dense(torch.where(drawn.heat == 1, logit, elsewhere), drawn.boxes)


def value(
    situation: Situation,
    delta: torch.Tensor,
    objective: Objective | None = None,
    target_groups: TargetGroups = everyone,
) -> torch.Tensor:
    """The value of δ in each world; an attacker must be in a group of every world."""
    targets = collect_targets(situation, target_groups, torch.ones(len(delta), dtype=torch.bool), joint=True)
    return attack_loss(targets, objective or UntargetedObjective())(delta)


def groups_of(groups: torch.Tensor) -> TargetGroups:
    """Target groups of one group for each world."""
    return lambda situation: (groups[:, None], torch.ones(len(groups), 1))


def simulate(delta: torch.Tensor, rngs: Sequence[np.random.Generator]) -> Any:
    """A defence that parts four vehicles at random, asks for both groups, fuses everyone and flags none."""
    judgements = []
    for e, _ in enumerate(delta):
        order = rngs[e].permutation(4).tolist()
        groups = frozenset(order[:2]), frozenset(order[2:])
        nothing = Detections(np.zeros((0, 5)), np.zeros(0))
        view = View(groups[0], 0, np.zeros(2), nothing, nothing, np.zeros((1, 1)))
        judgements.append(Judgement(Verdict(range(4)), view, groups, 2))
    return SimpleNamespace(judgements=tuple(judgements))


def _world(seed: int, n_attackers: int, n_maps: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    rng = np.random.default_rng(seed)
    features = rng.standard_normal((n_maps, CHANNELS, SIZE, SIZE), dtype=np.float32).clip(0)
    pose = np.concatenate([rng.uniform(-20, 20, (n_maps, 2)), np.zeros((n_maps, 1))], axis=1).astype(np.float32)
    pose[0] = 0
    features[0, :, :, : SIZE // 2] = 0  # the ego sees nothing in the west
    attackers = np.sort(rng.choice(n_maps, n_attackers, replace=False))
    return torch.from_numpy(features), torch.from_numpy(pose), torch.from_numpy(attackers)
