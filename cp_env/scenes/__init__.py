"""Where scenes come from. A source is named by a string at the outer door; objects are accepted everywhere."""

from __future__ import annotations

from cp_env.scenes.town import KINDS, SPLITS, Town
from cp_env.types import SceneSource

__all__ = ["KINDS", "SPLITS", "Town", "open_source"]


def open_source(spec: str | SceneSource) -> SceneSource:
    """The source that `spec` names; a source itself is handed back.

    Args:
        spec: "town" (its training split), "town/train", "town/calibration", "town/test", or an object.

    Raises:
        ValueError: unknown name, an object that is no source, or a broken recording.
    """
    if not isinstance(spec, str):
        if not isinstance(spec, SceneSource):
            raise ValueError(
                f"scenes must be a name or a SceneSource (name, digest, names, load, sweeps); got {spec!r}"
            )
        return spec
    family, _, split = spec.partition("/")
    if family != "town" or (split or "train") not in SPLITS:
        known = ", ".join(["town", *(f"town/{name}" for name in SPLITS)])
        raise ValueError(f"unknown scenes {spec!r}; known: {known}")
    return Town(split or "train")
