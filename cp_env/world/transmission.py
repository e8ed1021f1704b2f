"""The one way from an attack to the ego: F_i + δ_i with ‖δ_i‖ ≤ Δ, checked, before the warp (PRBI Eq. 1)."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from cp_env.perturbation import channel
from cp_env.settings import Settings
from cp_env.world.situation import Situation

PLAIN = (Tensor, torch.nn.Parameter)
"""The types that δ may have: a subclass may answer `clamp` and `abs` as it likes."""
ROUNDING = 1e-5
"""Share of Δ by which single precision may exceed it after the projection."""


def transmit(
    situation: Situation, delta: object, settings: Settings
) -> tuple[Float[Tensor, "E N C H W"], Float[np.ndarray, "E k"]]:
    """What the ego receives if the attackers add δ to their maps.

    Args:
        situation: the world's own, before anyone acts.
        delta: [E, k, C, H, W], in the senders' frames; larger ones are projected onto the ball.
        settings: budget and norm are read here and nowhere else: what was handed out does not count.

    Returns:
        All maps in the ego's frame, and ‖δ‖ of what was sent [E, k].

    Raises:
        ValueError: δ is no plain tensor, has the wrong shape, is not finite, or is not in the ball after projection.
    """
    plain = _plain(delta, (*situation.attackers.shape, *situation.received.shape[2:])).to(situation.received.device)
    sent = channel.norm_of(plain, settings.norm)
    if not bool(torch.isfinite(sent).all()):
        raise ValueError("a perturbation must be finite, but it holds NaN or infinity; check the attack")
    active = situation.active[:, None] & situation.present.gather(1, situation.attackers)
    if not bool((sent * active).any()):
        return situation.received, torch.zeros_like(sent).cpu().numpy()
    bounded = channel.project(plain, settings.budget, settings.norm) * active[..., None, None, None]
    norms = channel.norm_of(bounded, settings.norm)
    if not bool((norms <= settings.budget * (1 + ROUNDING)).all()):
        raise ValueError(f"‖δ‖ must be at most Δ = {settings.budget}, not {float(norms.max())}; it was not sent")
    index = situation.attackers[..., None].expand(-1, -1, 3)
    warped = situation.detector.warp(bounded, situation.ego_T_sender.gather(1, index))
    return channel.inject(situation.received, warped, situation.attackers), norms.cpu().numpy()


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
