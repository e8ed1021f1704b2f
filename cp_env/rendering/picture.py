"""What the picture of one frame shows, apart from how it is drawn. Positions and boxes are in the ego's grid frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from cp_env.metrics.similarity import match
from cp_env.types import Detections

FOUND_AT = 0.5
"""IoU at which a box counts as seen."""
STANDING = 0.3
"""m; points that are lower are the ground's."""


@dataclass(frozen=True, eq=False)
class Picture:
    """The content of one frame's picture; m, rad."""

    frame: int
    points: Sequence[Float[np.ndarray, "_ 3"]]  # one sweep a map, the ego's first, all moved into the ego's frame
    places: Float[np.ndarray, "N 2"]  # where each map's sensor is
    truth: Float[np.ndarray, "L 5"]
    seen: Detections  # everyone fused
    output: Detections  # what the ego acts on
    attackers: frozenset[int]
    suspects: frozenset[int]
    collaborators: frozenset[int]  # fused for the output
    similarity: Sequence[float]  # of every frame so far, this one last; NaN where there was none
    verifications: int
    damage: float  # 1 - Jaccard of the output and the unattacked output
    title: str = ""  # the scene
    defence: str = ""  # the defender's name; "none" for no defence
    attack: str = ""  # the attack's name, where it is known
    threshold: float | None = None  # ε, drawn across the similarities
    horizon: int = 100  # frames the strip has room for
    extent: float = 32.0  # m, half the edge of a panel

    @property
    def defended(self) -> str:
        """The defence in words."""
        return "no defence" if self.defence == "none" else f"defended by {self.defence}" if self.defence else "defended"


def wrong_rows(boxes: Float[np.ndarray, "K 5"], truth: Float[np.ndarray, "L 5"]) -> tuple[set[int], set[int]]:
    """The boxes that are ghosts, and the true vehicles that are missed (rows of each)."""
    pairs = match(boxes, truth, FOUND_AT)
    found, known = {int(a) for a, _ in pairs}, {int(b) for _, b in pairs}
    return set(range(len(boxes))) - found, set(range(len(truth))) - known


def standing_points(picture: Picture) -> Picture:
    """The picture without the LiDAR points of the ground."""
    return replace(picture, points=[points[points[:, 2] >= STANDING] for points in picture.points])


def telling_frame(pictures: Sequence[Picture]) -> int:
    """The frame that says most when it stands alone, as a film does where it is not played.

    It is the one in which the defence corrects most ghosts and misses; where it corrects none in any frame, the one
    with most of them. The earliest counts among equals.
    """

    def errors(picture: Picture, boxes: Detections) -> int:
        return sum(map(len, wrong_rows(boxes.boxes, picture.truth)))

    def says(number: int) -> tuple[int, int]:
        picture = pictures[number]
        attacked = errors(picture, picture.seen)
        return attacked - errors(picture, picture.output), attacked

    return max(range(len(pictures)), key=says)
