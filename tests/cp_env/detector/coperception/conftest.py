"""Maps that coperception's detector makes of a few vehicles."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from tests.helpers.coperception_views import LATTICE_POSES, POSES, detector, voxels


@pytest.fixture(scope="session")
def received() -> Tensor:
    """Two worlds of three maps."""
    maps = detector().encode_grids(voxels())
    one = detector().warp(maps, torch.tensor(POSES))
    return torch.stack([one, detector().warp(maps.flip(0), torch.tensor(LATTICE_POSES))])
