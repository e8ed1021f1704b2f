"""Perturbations of shared maps: the channel that bounds them, and the loss that attacks ascend."""

from __future__ import annotations

from cp_env.perturbation.ball import Ball, make_ball
from cp_env.perturbation.channel import inject, norm_of, project
from cp_env.perturbation.objective import adversarial_loss
from cp_env.perturbation.output import attacked_output

__all__ = ["Ball", "adversarial_loss", "attacked_output", "inject", "make_ball", "norm_of", "project"]
