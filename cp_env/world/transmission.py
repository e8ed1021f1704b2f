"""The one way from an attack to the ego: F_i + δ_i with ‖δ_i‖ ≤ Δ, checked, before the warp (PRBI Eq. 1)."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from cp_env.perturbation import channel
from cp_env.settings import Settings
from cp_env.world import received
from cp_env.world.situation import Situation

PLAIN = (Tensor, torch.nn.Parameter)
"""The types that δ may have: a subclass may answer `clamp` and `abs` as it likes."""

ROUNDING = 1e-5
"""Share of Δ by which single precision may exceed it after the projection."""

TOGETHER = {"cpu": 2}
"""Perturbations that are checked and added in one go, by kind of device: as many as stay in a core's own cache. All of
them elsewhere."""


def transmit(situation: Situation, delta: object, settings: Settings) -> Float[np.ndarray, "E k"]:
    """Add δ to the attackers' maps in `situation.received`, moved to the ego's frame; all other maps stay.

    Args:
        situation: the world's own, before anyone acts; its maps are overwritten, even if this fails.
        delta: [E, k, C, H, W], in the senders' frames; larger ones are projected onto the ball.
        settings: budget and norm are read here and nowhere else: what was handed out does not count.

    Returns:
        ‖δ‖ of what was sent.

    Raises:
        ValueError: δ is no plain tensor, has the wrong shape, is not finite, or is not in the ball after projection.
    """
    maps, attackers = situation.received, situation.attackers
    plain = _plain(delta, (*attackers.shape, *maps.shape[2:])).to(maps.device)
    if not all(bool(torch.isfinite(channel.norm_of(one, settings.norm)).all()) for one in _together(plain)):
        raise ValueError("a perturbation must be finite, but it holds NaN or infinity; check the attack")
    norms = torch.zeros(attackers.shape, device=maps.device)
    sending = torch.nonzero(situation.active[:, None] & situation.present.gather(1, attackers))
    for part in _together(sending):
        world, slot = part.unbind(1)
        vehicle, mine = attackers[world, slot], plain[world, slot]  # a copy: nobody else can change it any more
        bounded = channel.project(mine, settings.budget, settings.norm)
        sent = channel.norm_of(bounded, settings.norm)
        if not bool((sent <= settings.budget * (1 + ROUNDING)).all()):
            raise ValueError(f"‖δ‖ must be at most Δ = {settings.budget}, not {float(sent.max())}; it was not sent")
        norms[world, slot] = sent
        rows = (world * maps.shape[1] + vehicle).tolist()
        received.add(situation.detector, maps.flatten(0, 1), rows, bounded, situation.ego_T_sender[world, vehicle])
    return norms.cpu().numpy()


@contextmanager
def unperturbed_after(situation: Situation) -> Iterator[None]:
    """Put the attackers' maps back as they were, whatever was added to them meanwhile."""
    worlds = torch.arange(len(situation.attackers), device=situation.attackers.device)[:, None]
    before = situation.received[worlds, situation.attackers]
    try:
        yield
    finally:
        situation.received[worlds, situation.attackers] = before


def _together(rows: Tensor) -> tuple[Tensor, ...]:
    """The rows in parts that are worked on in one go."""
    return rows.split(TOGETHER.get(rows.device.type, max(len(rows), 1)))


def _plain(delta: object, shape: tuple[int, ...]) -> Tensor:
    """δ as a plain floating-point tensor of that shape, cut off from any graph."""
    if type(delta) not in PLAIN:
        raise ValueError(f"a perturbation must be a plain torch.Tensor, not {type(delta).__name__}")
    assert isinstance(delta, Tensor)
    if tuple(delta.shape) != shape:
        raise ValueError(f"a perturbation must have shape [E, k, C, H, W] = {shape}, not {tuple(delta.shape)}")
    if not delta.is_floating_point() or delta.layout != torch.strided:
        raise ValueError(f"a perturbation holds dense real numbers, not {delta.dtype} ({delta.layout})")
    return delta.detach().to(torch.float32)
