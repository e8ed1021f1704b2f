"""Pictures of a world's last frame."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from cp_env.geometry.planar import grid_origin
from cp_env.rendering.frame import draw
from cp_env.rendering.panel import Image3
from cp_env.rendering.picture import Picture
from cp_env.world.situation import Outcome
from cp_env.world.world import World
from defenders import DEFENDERS, Defender, HasThreshold


class Camera:
    """Pictures of a world's frames. It must `record` every outcome: it keeps the similarities of the episode.

    Sweeps are read from the scene source again when a picture is rendered, so recording costs nothing.

    Args:
        world: the world whose frames are shown.
        attack: the attack's name, which a world does not know.
    """

    def __init__(self, world: World, attack: str = "") -> None:
        self._world, self._attack = world, attack
        self._outcome: Outcome | None = None
        self._similarity: list[list[float]] = [[] for _ in range(world.num_envs)]

    def record(self, outcome: Outcome) -> None:
        """Keep the outcome of the frame just played."""
        self._outcome = outcome
        for past, frame, value in zip(self._similarity, outcome.frame, outcome.similarity, strict=True):
            past += [float("nan") if frame == 0 else float(value)]

    def reset(self, worlds: Sequence[int]) -> None:
        """Discard the similarities of `worlds`, where new episodes begin."""
        for e in worlds:
            self._similarity[e] = []

    def render(self, world: int = 0) -> Image3:
        """The last frame of world `world`; the unattacked first frame if none was played since its reset."""
        return draw(self.picture(world))

    def picture(self, e: int) -> Picture:
        """The `Picture` that `render` draws."""
        world, settings = self._world, self._world.settings
        everyone = frozenset(range(settings.n_maps))
        episode, frame = world.places[e]
        attackers = frozenset(int(i) for i in world.attackers[e])
        outcome = self._outcome if self._similarity[e] else None
        if outcome is not None and not outcome.truncated[e]:
            frame -= 1  # the world has moved on already
        points, places = self._sensed(e, frame)
        view = episode.clean_views[frame] if outcome is None else outcome.seen[e]
        output = view if outcome is None else outcome.output[e]
        verdict = None if outcome is None else outcome.verdicts[e]
        return Picture(
            frame=0 if outcome is None else int(outcome.frame[e]),
            points=points,
            places=places,
            truth=episode.truth[frame],
            seen=view.seen,
            output=output.seen,
            attackers=attackers,
            suspects=frozenset() if verdict is None else verdict.suspects,
            collaborators=everyone if verdict is None else verdict.collaborators,
            similarity=tuple(self._similarity[e]),
            verifications=0 if outcome is None else int(outcome.verifications[e]),
            damage=0.0 if outcome is None else float(outcome.damage[e]),
            title=episode.scene.name,
            defence=DEFENDERS.name_of(world.defenders[e]),
            attack=self._attack,
            threshold=_alarm(world.defenders[e], everyone),
            horizon=settings.max_frames,
            extent=world.detector.extent,
        )

    def _sensed(self, e: int, frame: int) -> tuple[list[Float[np.ndarray, "_ 3"]], Float[np.ndarray, "N 2"]]:
        """Each map's points and sensor in the ego's grid frame; m."""
        settings, scene = self._world.settings, self._world.places[e][0].scene
        (sweeps,) = self._world.bank.source.sweeps(scene, [frame])
        used = [*sweeps[: settings.n_vehicles], *(sweeps[-1:] if settings.rsu else [])]
        origin = grid_origin(used[0].origin[:2])
        places = np.array([sweep.origin[:2] - origin for sweep in used], dtype=np.float64)
        points = [s.points + np.array([*shift, 0.0], s.points.dtype) for s, shift in zip(used, places, strict=True)]
        return points, places


def _alarm(defender: Defender, everyone: frozenset[int]) -> float | None:
    """The similarity below which the defender verifies, if it has such a threshold."""
    if not isinstance(defender, HasThreshold):
        return None
    epsilon = defender.epsilon
    return float(epsilon(everyone) if callable(epsilon) else epsilon)
