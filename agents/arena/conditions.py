"""What the programs that play many cells ask of whoever calls them, whatever they make of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from cp_env.evaluation import Protocol
from cp_env.scenes import open_source


@dataclass(frozen=True)
class Conditions:
    """Options of the command line that every cell shares."""

    scenes: str = "town/test"
    n_scenes: int | None = None  # play so many of them, spread evenly (all by default)
    frames: int = 100  # an episode's, five a second
    vehicles: int = 5
    weights: str | None = (
        None  # a file of the detector's, such as `cp_env.detector.training.train` writes; else those that ship
    )
    protocol: str = "strict"  # how AP is counted: "strict" or "coperception"
    batch: int = 4  # scenes in lock-step
    threads: int = 1  # torch threads of each process

    def on_scenes(self, **settings: Any) -> Protocol:
        """Themselves, on the scenes that are played, with what else a `Protocol` has. ValueError for bad ones."""
        return Protocol(
            self.scenes,
            spread(open_source(self.scenes).names(), self.n_scenes),
            self.frames,
            self.vehicles,
            ap=self.protocol,
            weights=self.weights,
            **settings,
        )


def spread(names: Sequence[str], wanted: int | None) -> tuple[str, ...]:
    """So many of the scenes, spread evenly over the list; all for None. ValueError for more than there are."""
    wanted = len(names) if wanted is None else wanted
    if not 1 <= wanted <= len(names):
        raise ValueError(f"n_scenes must be 1 to {len(names)}, not {wanted}")
    return tuple(names[i * len(names) // wanted] for i in range(wanted))
