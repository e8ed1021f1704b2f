"""What kind of vehicle each row of a scene is: as its source says, or as its size suggests."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

from cp_env.types import Scene, SceneSource

LONG, HIGH, BUS = 6.5, 3.0, 10.0  # m; a truck is longer and higher than the first two, a bus longer than the third


@runtime_checkable
class NamesClasses(Protocol):
    """A source that knows what its vehicles are."""

    def classes(self, scene: Scene) -> Sequence[str]:
        """A name for each of the scene's vehicles, such as "vehicle.car"."""
        ...


def classes_of(source: SceneSource, scene: Scene) -> tuple[tuple[str, ...], bool]:
    """The class of each of a scene's vehicles, and whether the source told it; else it is guessed from the size.

    Raises:
        ValueError: the source names more or fewer classes than the scene has vehicles.
    """
    if not isinstance(source, NamesClasses):
        return tuple(_by_size(length, height) for length, _, height in scene.size.tolist()), False
    names = tuple(source.classes(scene))
    if len(names) != len(scene.size):
        raise ValueError(
            f"{source.name} names {len(names)} classes for the {len(scene.size)} vehicles of scene {scene.name}; "
            "classes(scene) must name one for each row"
        )
    return names, True


def _by_size(length: float, height: float) -> str:
    return "bus" if length > BUS else "truck" if length > LONG and height > HIGH else "car"
