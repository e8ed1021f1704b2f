"""A coalition that gives one of its own away."""

from __future__ import annotations

from typing import Any

import torch
from jaxtyping import Bool
from torch import Tensor

from agents.attacks.gradient import Ascent, Cells
from agents.attacks.pgd import Steepest
from agents.protocol import Attacker
from cp_env.world.situation import Situation


def sacrifice(martyr: int = -1, steps: int = 15, step_size: float = 0.1, **knobs: Any) -> Attacker:
    """One liar lies so loudly that it is convicted; the others are silent until then, and lie once all is settled.

    Threat model: white-box on the detector, and the liars see the ego's verdicts (whom it fuses, whether it has
    converged). A defence that stops verifying when it has converged, as PRBI does, no longer looks when the others
    begin. Source: collusion with attackers of changing behaviour, against trust systems (Sun, Han, Liu, "Defense of
    Trust Management Vulnerabilities in Distributed Networks", 2008). A defence that never converges, as ROBOSAC and
    PASAC, which start anew with every frame, never hears from the silent ones. The loud one pauses once it is left out.

    martyr   which of the liars is given away, in ascending order of their numbers; the last by default
    knobs    of `Ascent`
    """
    return Ascent(Steepest(steps, step_size), audience="fused", where=speakers(martyr), **knobs)


def speakers(martyr: int) -> Cells:
    """All cells of those who may speak, none of the others': the martyr until it is left out for good, then all."""

    def cells(situation: Situation) -> Bool[Tensor, "E k H W"]:
        given = settled(situation, martyr)[:, None].repeat(1, situation.attackers.shape[1])
        given[:, martyr] = True
        height, width = situation.received.shape[-2:]
        return given[:, :, None, None].expand(-1, -1, height, width)

    return cells


def settled(situation: Situation, martyr: int) -> Bool[Tensor, " E"]:
    """The worlds in which the defence has converged on a verdict that leaves the martyr out."""
    liars = situation.attackers[:, martyr].tolist()
    verdicts = zip(situation.verdict, liars, strict=True)
    done = [v is not None and v.converged and liar not in v.collaborators for v, liar in verdicts]
    return torch.tensor(done, device=situation.attackers.device)
