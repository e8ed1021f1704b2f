"""Poisoning of the first frame: the perturbation is in the first reference, and stays."""

from __future__ import annotations

from agents.attacks.gradient import GradientAttack
from agents.attacks.objectives.scene_target import SceneTarget, lattice_ghosts
from agents.attacks.pgd import ProjectedGradient
from agents.protocol import Attack


def poison(spacing: float = 12.0, steps: int = 15, step_size: float = 0.1, target_groups: str = "fused") -> Attack:
    """Ghosts from the first frame on, and no real car.

    Threat model: white-box on the detector. Of the defence the attackers know that it trusts the first frame (PRBI,
    Algorithm 1, lines 6 to 10), and the episode's first frame is theirs: play it with `grace_frames=0`. A defence that
    takes it as the reference finds the attackers consistent and the benign vehicles not. Source: causative attacks,
    which corrupt what a detector learns from (Barreno et al., "Can Machine Learning Be Secure?", 2006); consistent
    removal and spoofing of cars over frames (Zhang et al., "On Data Fabrication in Collaborative Vehicular Perception",
    2024). The ghosts stand on a lattice that is fixed in the world, so each stays where it was first seen.

    Args:
        spacing: of the ghosts, m.
        steps: of the ascent.
        step_size: length of a step in the ball's norm.
        target_groups: the groups whose views are attacked, see `GradientAttack`.

    Returns:
        The attack.
    """
    return GradientAttack(
        ProjectedGradient(steps, step_size),
        random_start=False,
        objective=SceneTarget(lattice_ghosts(spacing)),
        target_groups=target_groups,
    )
