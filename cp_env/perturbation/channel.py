"""The channel: the only place where attackers act. F_i + δ_i with ‖δ_i‖ ≤ Δ, before the warp (PRBI Eq. 1)."""

from __future__ import annotations

import torch
from jaxtyping import Float, Int
from torch import Tensor

NORMS = ("linf", "l2")


def norm_of(delta: Float[Tensor, "*n C H W"], norm: str) -> Float[Tensor, "*n"]:
    """‖δ‖ of every map: the largest entry ("linf") or the Euclidean length over all entries ("l2"); NaN if one is."""
    flat = delta.flatten(-3)
    if norm == "linf":
        return torch.maximum(flat.amin(-1).abs(), flat.amax(-1).abs())
    return flat.double().norm(dim=-1).to(delta.dtype)  # single precision loses 1e-5 over so many entries


def project(
    delta: Float[Tensor, "*n C H W"], budget: float | Tensor, norm: str, out: Tensor | None = None
) -> Float[Tensor, "*n C H W"]:
    """The nearest perturbation with ‖δ‖ ≤ Δ: clipped ("linf") or shortened ("l2").

    Args:
        delta: perturbations of the maps.
        budget: one Δ for all maps, or a tensor that broadcasts against them.
        norm: "linf" or "l2".
        out: where they are written; `delta` itself is allowed. A new tensor by default.

    Returns:
        The projected perturbations.
    """
    if norm == "linf":
        if isinstance(budget, Tensor):  # `clamp` takes six times as long with tensors
            return torch.minimum(torch.maximum(delta, -budget, out=out), budget, out=out)
        return torch.clamp(delta, -budget, budget, out=out)
    length = norm_of(delta, norm)[..., None, None, None].clamp(min=1e-12)
    return torch.mul(delta, (budget / length).clamp(max=1.0), out=out)


def inject(
    received: Float[Tensor, "E N C H W"], warped: Float[Tensor, "E k C H W"], attackers: Int[Tensor, "E k"]
) -> Float[Tensor, "E N C H W"]:
    """The received maps with the attackers' warped perturbations added to their rows; differentiable in `warped`."""
    worlds, maps = received.shape[:2]
    rows = torch.arange(worlds, device=attackers.device)[:, None] * maps + attackers
    added = warped.flatten(0, 1).to(received.dtype)
    return received.flatten(0, 1).index_add(0, rows.flatten(), added).unflatten(0, (worlds, maps))
