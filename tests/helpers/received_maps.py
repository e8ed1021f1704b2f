"""Detectors of every fusion with random weights, and groups of vehicles in two worlds."""

from __future__ import annotations

import torch

from cp_env.detector import Detector
from cp_env.detector.model.fusion import FUSIONS

E, N, C, SIZE = 2, 4, 16, 32


Situation = tuple[torch.Tensor, torch.Tensor]


def lively(name: str) -> Detector:
    """A detector whose fusion's last layers, zero before training, are not."""
    with torch.random.fork_rng():
        torch.manual_seed(0)  # torch's layers draw their first weights from nowhere else
        detector = Detector(fusion=name, channels=C)
        with torch.no_grad():
            for parameter in detector.fuser.parameters():
                if not parameter.any():
                    parameter.normal_(std=0.5)
    return detector.freeze()


DETECTORS = {name: lively(name) for name in FUSIONS}


WORLD = torch.tensor([0, 1, 1, 0, 1, 0])


GROUPS = torch.tensor(
    [
        [True, True, True, True],
        [True, True, True, True],
        [False, True, True, False],  # without the ego
        [False, False, True, False],  # of one
        [False, False, False, True],  # of one that covers nothing
        [True, False, False, False],
    ]
)
