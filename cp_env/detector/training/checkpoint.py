"""Checkpoints of a training run, as safetensors: nothing that has to be unpickled, and read within bounds."""

from __future__ import annotations

import logging
from collections import defaultdict
from pathlib import Path

import torch
from safetensors.torch import save_file
from torch import nn

from cp_env.detector.model.tensors import read_tensors

log = logging.getLogger(__name__)

_MODEL, _OPTIMIZER = "model.", "optimizer."  # beginnings of the names of tensors


def write_checkpoint(path: Path, detector: nn.Module, optimizer: torch.optim.Optimizer, step: int) -> None:
    """Weights, and AdamW's step and two moments of each; nothing that has to be unpickled."""
    tensors = {f"{_MODEL}{name}": tensor for name, tensor in detector.state_dict().items()}
    for number, moments in optimizer.state_dict()["state"].items():
        tensors |= {f"{_OPTIMIZER}{number}.{name}": tensor for name, tensor in moments.items()}
    partial = path.with_suffix(".part")
    save_file({key: tensor.cpu().contiguous() for key, tensor in tensors.items()}, partial, {"step": str(step)})
    partial.rename(path)


def resume(path: Path, detector: nn.Module, optimizer: torch.optim.Optimizer) -> int:
    """The step to go on with.

    Raises:
        ValueError: the checkpoint is broken, of other settings, or exceeds a bound of `tensors`.
    """
    if not path.exists():
        return 0
    try:
        notes, tensors = read_tensors(path)
        step = int(notes["step"])
        detector.load_state_dict(
            {key.removeprefix(_MODEL): tensor for key, tensor in tensors.items() if key.startswith(_MODEL)}
        )
        state: dict[int, dict[str, torch.Tensor]] = defaultdict(dict)
        for key in (key for key in tensors if key.startswith(_OPTIMIZER)):
            number, name = key.removeprefix(_OPTIMIZER).split(".")
            state[int(number)][name] = tensors[key]
        optimizer.load_state_dict({"state": dict(state), "param_groups": optimizer.state_dict()["param_groups"]})
    except (OSError, ValueError, KeyError, RuntimeError) as error:
        raise ValueError(
            f"cannot go on from {path}: {str(error)[:500]}; delete it to begin anew, or choose another --out"
        ) from error
    log.info("going on from step %d of %s", step, path)
    return step
