"""Noise in the ball: the baseline of every gradient attack."""

from __future__ import annotations

import torch

from tests.agents.attacks.test_gradient import MODEL, _act, _loss
from tests.helpers import situations


def test_noise_is_weaker_than_bim_and_bim_than_pgd_with_restarts() -> None:
    situation = situations.situation(MODEL, n_worlds=6)
    found = [_act(spec, situation) for spec in ("noise", "bim", "pgd", "pgd:restarts=3")]
    noise, bim, pgd, restarted = (_loss(situation, delta) for delta in found)
    assert (noise < bim / 3).all() and (noise < pgd / 3).all()
    assert (restarted >= torch.maximum(bim, pgd) - 1e-5).all() and (restarted > pgd + 1e-4).any()
