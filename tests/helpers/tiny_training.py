"""The smallest training run."""

from __future__ import annotations

import torch


def _overlap(sender: torch.Tensor, ego: torch.Tensor, x: int, y: int) -> tuple[torch.Tensor, torch.Tensor]:
    """The part of the sender's map on the ego's, in both, for a shift by whole cells."""
    size = len(ego)
    rows, cols = slice(max(y, 0), size + min(y, 0)), slice(max(x, 0), size + min(x, 0))
    back_rows, back_cols = slice(max(-y, 0), size + min(-y, 0)), slice(max(-x, 0), size + min(-x, 0))
    return sender[back_rows, back_cols], ego[rows, cols]
