"""The one way from an attack to the ego: F_i + δ_i with ‖δ_i‖ ≤ Δ, checked, before the warp (PRBI Eq. 1)."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from cp_env.perturbation import channel
from cp_env.settings import Settings
from cp_env.world import received
from cp_env.world.situation import Situation

PLAIN = (Tensor, torch.nn.Parameter)
"""The types that δ may have: a subclass may answer `clamp` and `abs` as it likes."""

ROUNDING = 1e-5
"""Share of Δ by which single precision may exceed it after the projection."""

TOGETHER = {"cpu": 1 << 20}
"""Bytes of perturbations that are checked and added in one go, by kind of device: as many as stay in a core's own
cache. All of them elsewhere."""


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
    maps, attackers, k = situation.received, situation.attackers, situation.attackers.shape[1]
    plain = _plain(delta, (*attackers.shape, *maps.shape[2:])).to(maps.device)
    norms = torch.zeros(attackers.shape, device=maps.device)
    sending = situation.active[:, None] & situation.present.gather(1, attackers)
    for part in _together(torch.nonzero(~sending), plain):
        _finite(plain[part.unbind(1)], settings.norm)
    for part in _together(torch.nonzero(sending), plain):
        world, slot = part.unbind(1)
        vehicle = attackers[world, slot]
        mine = plain.flatten(0, 1).index_select(0, world * k + slot)  # a copy: nobody else can change it any more
        bounded, sent = _bounded(mine, settings)
        norms[world, slot] = sent
        rows = (world * maps.shape[1] + vehicle).tolist()
        received.add(situation.detector, maps.flatten(0, 1), rows, bounded, situation.ego_T_sender[world, vehicle])
    return norms.cpu().numpy()


@contextmanager
def unperturbed_after(situation: Situation) -> Iterator[None]:
    """Put the attackers' maps back as they were, whatever was added to them meanwhile."""
    maps, worlds = situation.received.flatten(0, 1), len(situation.attackers)
    first = torch.arange(worlds, device=maps.device)[:, None] * (len(maps) // worlds)
    rows = (first + situation.attackers).flatten()
    before = maps.index_select(0, rows)
    try:
        yield
    finally:
        maps.index_copy_(0, rows, before)


def _bounded(
    mine: Float[Tensor, "R C H W"], settings: Settings
) -> tuple[Float[Tensor, "R C H W"], Float[Tensor, " R"]]:
    """The perturbations inside the ball, and their norms: what is inside already needs no projection."""
    norm = _finite(mine, settings.norm)
    if not bool((norm <= settings.budget).all()):
        mine = channel.project(mine, settings.budget, settings.norm)
        norm = channel.norm_of(mine, settings.norm)
    if not bool((norm <= settings.budget * (1 + ROUNDING)).all()):
        raise ValueError(f"‖δ‖ must be at most Δ = {settings.budget}, not {float(norm.max())}; it was not sent")
    return mine, norm


def _finite(delta: Float[Tensor, "R C H W"], norm: str) -> Float[Tensor, " R"]:
    """The norms, which must be finite."""
    norms = channel.norm_of(delta, norm)
    if not bool(torch.isfinite(norms).all()):
        raise ValueError("a perturbation must be finite, but it holds NaN or infinity; check the attack")
    return norms


def _together(rows: Int[Tensor, "R 2"], delta: Float[Tensor, "E k C H W"]) -> tuple[Tensor, ...]:
    """The rows in parts that are worked on in one go."""
    one = 4 * math.prod(delta.shape[2:])
    most = TOGETHER.get(delta.device.type)
    return rows.split(max(most // one, 1) if most else max(len(rows), 1))


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
