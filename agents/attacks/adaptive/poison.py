"""The first frame poisoned: the lie is in the very first reference, and is kept."""

from __future__ import annotations

from agents.attacks.gradient import Ascent
from agents.attacks.objectives.scene_target import Picture, crossings
from agents.attacks.pgd import Steepest
from agents.protocol import Attacker


def poison(spacing: float = 12.0, steps: int = 15, step_size: float = 0.1, audience: str = "fused") -> Attacker:
    """Liars who show the same ghosts from the first frame on, and no real car.

    Threat model: white-box on the detector; of the defence they know that it trusts the first frame (PRBI, Algorithm 1,
    lines 6 to 10) and that the episode's first frame is theirs: play it with `grace_frames=0`. A defence that takes it
    as the reference finds whoever repeats the lie normal, and the honest abnormal. Source: causative attacks, which
    corrupt what a detector learns from (Barreno et al., "Can Machine Learning Be Secure?", 2006); consistent removal
    and spoofing of cars over frames (Zhang et al., "On Data Fabrication in Collaborative Vehicular Perception", 2024).
    The ghosts stand `spacing` m apart on a lattice that is fixed in the world, so each stays where it was first seen.
    """
    return Ascent(
        Steepest(steps, step_size), random_start=False, objective=Picture(crossings(spacing)), audience=audience
    )
