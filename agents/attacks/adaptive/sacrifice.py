"""A coalition that sacrifices one of its attackers."""

from __future__ import annotations

from typing import Any

import torch
from jaxtyping import Bool
from torch import Tensor

from agents.attacks.gradient import Cells, GradientAttack
from agents.attacks.pgd import ProjectedGradient
from agents.protocol import Attack
from cp_env.world.situation import Situation
from defenders.registry import typed_options


def sacrifice(sacrificed: int = -1, steps: int = 15, step_size: float = 0.1, **options: Any) -> Attack:
    """One attacker perturbs until it is excluded; the others send no perturbation until then, and attack afterwards.

    Threat model: white-box on the detector. The attackers see the ego's verdicts (the vehicles it fuses, whether it has
    converged). A defence that stops verifying when it has converged, as PRBI does, verifies no more when the others
    begin. Source: collusion with attackers of changing behaviour, against trust systems (Sun, Han, Liu, "Defense of
    Trust Management Vulnerabilities in Distributed Networks", 2008). Against a defence that never converges, as ROBOSAC
    and PASAC, which start anew with every frame, the others never begin. The sacrificed one pauses once it is left out.

    Args:
        sacrificed: which of the attackers is sacrificed, in ascending order of their numbers; the last by default.
        steps: of the ascent.
        step_size: length of a step in the ball's norm.
        options: of `GradientAttack`.

    Returns:
        The attack.

    Raises:
        ValueError: an option that `GradientAttack` has not, or a value of the wrong type.
    """
    own = typed_options(GradientAttack, options, "attack 'sacrifice'", given=("optimizer", "target_groups", "where"))
    return GradientAttack(
        ProjectedGradient(steps, step_size), target_groups="fused", where=perturbing_cells(sacrificed), **own
    )


def perturbing_cells(sacrificed: int) -> Cells:
    """All cells of the attackers that may perturb: the sacrificed one until it is excluded for good, then all."""

    def cells(situation: Situation) -> Bool[Tensor, "E k H W"]:
        given = sacrifice_excluded(situation, sacrificed)[:, None].repeat(1, situation.attackers.shape[1])
        given[:, sacrificed] = True
        height, width = situation.coverage.shape[-2:]
        return given[:, :, None, None].expand(-1, -1, height, width)

    return cells


def sacrifice_excluded(situation: Situation, sacrificed: int) -> Bool[Tensor, " E"]:
    """The worlds in which the defence has converged on a verdict that leaves the sacrificed attacker out."""
    attackers = situation.attackers[:, sacrificed].tolist()
    verdicts = zip(situation.verdict, attackers, strict=True)
    done = [v is not None and v.converged and attacker not in v.collaborators for v, attacker in verdicts]
    return torch.tensor(done, device=situation.attackers.device)
