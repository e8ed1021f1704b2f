"""A detector of your own as the victim: two methods, the rules it must keep, and attacks through its gradients.

    python examples/bring_your_own_detector.py
    python examples/bring_your_own_detector.py --steps 30 --budget 0.1

The toy below has no trained weights: whatever is as high as a car, and not as high as a house, is a car to it. It is
not a good detector, but everything works with it: fusion, defenders, PGD, PPO, pictures.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
import tyro
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn import functional

import agents
import cp_env
from cp_env.detector import Dense
from cp_env.detector.model.base import BaseDetector
from cp_env.detector.model.bev import BEV, rasterise
from cp_env.testing import check_detector
from cp_env.types import Sweep

# Evidence of a car from a return, by its height: ground, bumper, bonnet, window, roof, van, house.
EVIDENCE = (-0.4, 3.0, 5.0, 4.0, 2.0, -2.0, -4.0)
CAR = (4.5, 1.8)  # length and width of every box, m


@dataclass(frozen=True)
class Args:
    """A toy detector under attack."""

    scene: str = "town/test"
    frames: int = 10
    steps: int = 15  # of the attack
    budget: float = 0.3
    seed: int = 0


class Toy(BaseDetector):
    """Shared maps are shares of occupied voxels by height, in cells of 2 m; scores are a weighted sum of their mean."""

    channels = BEV.slices
    threshold = 0.5

    evidence: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("evidence", torch.tensor(EVIDENCE))

    def encode(self, sweeps: Sequence[Sweep]) -> Float[Tensor, "B C H W"]:
        """f_E: the square root brings out the few returns from what is far."""
        occupied = rasterise(sweeps).to(self.evidence)
        return functional.avg_pool2d(occupied, BEV.size // self.size).sqrt()

    def perceive(
        self,
        received: Float[Tensor, "E N C H W"],
        coverage: Float[Tensor, "E N H W"],
        world: Int[Tensor, " B"],
        groups: Bool[Tensor, "B N"],
    ) -> Dense:
        """f_F and f_D: the mean over the members that cover a cell; then every metre gets a score for a car."""
        if not bool(groups.any(1).all()):
            raise ValueError("a group holds at least one vehicle")
        members = (coverage[world] * groups[..., None, None])[:, :, None]
        # a sum over the members in a fixed order: a view does not depend on the others of its batch
        fused = sum((received[world] * members).unbind(1)) / members.sum(1).clamp(min=1)
        score = torch.einsum("bchw,c->bhw", fused, self.evidence)
        fine = functional.interpolate(score[:, None], scale_factor=2.0, mode="bilinear")[:, 0]
        return Dense(6 * fine - 5, self._boxes(fine))

    def _boxes(self, score: Float[Tensor, "B h w"]) -> Float[Tensor, "B 6 h w"]:
        """Cars, standing in the cell's middle, along the ridge of the score: across it, it changes most."""
        padded = functional.pad(score[:, None], (1, 1, 1, 1), mode="replicate")[:, 0]
        east, north = padded[:, 1:-1, 2:] - padded[:, 1:-1, :-2], padded[:, 2:, 1:-1] - padded[:, :-2, 1:-1]
        across = torch.stack([-2 * east * north, north**2 - east**2], dim=1)
        direction = functional.avg_pool2d(across, 5, stride=1, padding=2)
        length, width = (torch.full_like(score, float(np.log(side))) for side in CAR)
        still = torch.zeros_like(score)
        return torch.cat([torch.stack([still, still, length, width], dim=1), direction], dim=1)


def damage(detector: Toy, attack: agents.Attack, args: Args) -> float:
    """Mean damage per frame that two attackers of five do to an ego that fuses everyone."""
    world = cp_env.world.world.World(
        1, defender="none", detector=detector, scenes=args.scene, max_frames=args.frames, budget=args.budget
    )
    world.reset([args.seed])
    attack.reset(1, np.random.default_rng(args.seed).spawn(1))
    return float(np.mean([world.step(attack.act(world.situation())).damage[0] for _ in range(args.frames)]))


def main(args: Args) -> None:
    torch.set_num_threads(1)
    detector = Toy()
    detector.freeze()
    print(f"{len(check_detector(detector))} rules kept")
    for name, attack in (
        ("noise", agents.make("noise")),
        (f"PGD, {args.steps} steps", agents.make("pgd", steps=args.steps)),
    ):
        print(f"detection loss/frame under {name}: {damage(detector, attack, args):.2f}")


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
