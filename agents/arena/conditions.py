"""Command-line options that all programs of many runs share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import defenders
from cp_env.detector.protocol import DetectorLike, fusion_of
from cp_env.evaluation import Conditions
from cp_env.scenes import open_source
from cp_env.settings import Fusion, Precision
from cp_env.world.streams import PUBLIC_KEY


@dataclass(frozen=True)
class CommonOptions:
    """Options of the command line that every run shares."""

    scenes: str = "town/test"
    n_scenes: int | None = None  # play so many of them, spread evenly (all by default)
    frames: int = 100  # an episode's, five a second
    vehicles: int = 5
    rsu: bool = False  # with the road-side unit's map as the last one; one vehicle is enough then
    detector: str = "cp_env"  # or coperception:checkpoint=FILE, or module:Class of yours
    weights: str | None = None  # a file that `cp_env.detector.training.train` writes; else those that ship
    precision: Precision = "float32"  # of the detector's maps, fusion and decoder; bfloat16 is faster (docs/speed.md)
    protocol: str = "strict"  # how AP is counted: "strict" or "coperception"
    batch: int = 4  # scenes in lock-step
    threads: int = 1  # torch threads of each process
    sealed: bool = False  # each defender in a process of its own, which holds handles instead of views
    key: Path | None = None  # a file with a long secret text, so that nobody can work out the episodes from the seeds

    def on_scenes(self, **settings: Any) -> Conditions:
        """The conditions of the scenes that are played.

        Args:
            settings: further fields of `Conditions`.

        Raises:
            ValueError: scenes or settings that cannot be played.
        """
        known = {field.name for field in fields(Conditions)} - {"scenes", "names", "frames", "key"}
        own = {field.name: getattr(self, field.name) for field in fields(CommonOptions) if field.name in known}
        return Conditions(
            self.scenes,
            spread(open_source(self.scenes).names(), self.n_scenes),
            self.frames,
            self.vehicles,
            ap=self.protocol,
            key=PUBLIC_KEY if self.key is None else read_key(self.key),
            **{**own, **settings},
        )


def read_key(path: Path) -> str:
    """The key of a hidden benchmark, from its file.

    Raises:
        ValueError: no such file, or a text that could be guessed: fewer than 32 characters.
    """
    try:
        key = path.read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"cannot read the key in {path} ({error})") from error
    if len(key) < 32:
        raise ValueError(
            f"the key in {path} has {len(key)} characters and could be guessed; 32 is the least. "
            "Make one by: openssl rand -hex 32"
        )
    return key


def check_calibration(entries: Sequence[str], detector: DetectorLike, fusion: Fusion) -> None:
    """Warn of each defender whose calibration was measured with other weights: here, so that no worker has to."""
    for entry in entries:
        defenders.make(entry).configure(fusion=fusion_of(detector, fusion))


def spread(names: Sequence[str], wanted: int | None) -> tuple[str, ...]:
    """Scenes spread evenly over the list; all for None.

    Raises:
        ValueError: more scenes than there are, or none.
    """
    wanted = len(names) if wanted is None else wanted
    if not 1 <= wanted <= len(names):
        raise ValueError(f"n_scenes must be 1 to {len(names)}, not {wanted}")
    return tuple(names[i * len(names) // wanted] for i in range(wanted))
