"""What all detectors share: a fingerprint of the weights, and the refusal of empty groups."""

from __future__ import annotations

import hashlib

import torch
from jaxtyping import Bool
from torch import Tensor, nn


def fingerprint(module: nn.Module, conditions: str) -> str:
    """16 hexadecimal digits that change with any weight or buffer of the module, and with `conditions`."""
    sha = hashlib.sha256(conditions.encode())
    for name, tensor in sorted(module.state_dict().items()):
        sha.update(name.encode())
        exact = tensor.float() if tensor.dtype == torch.bfloat16 else tensor  # NumPy has no such numbers
        sha.update(exact.detach().cpu().contiguous().numpy().tobytes())
    return sha.hexdigest()[:16]


def refuse_empty(groups: Bool[Tensor, "B N"]) -> None:
    """ValueError, naming the rows, if a group holds nobody."""
    if not bool(groups.any(dim=1).all()):
        empty = (~groups.any(dim=1)).nonzero()[:, 0].tolist()
        raise ValueError(f"a group holds at least one vehicle: rows {empty} of groups hold none; leave them out")
