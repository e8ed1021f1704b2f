"""Any source's scenes in the layout of a public data set: for other people's tools, and for round trips."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

from cp_env.scenes.clip import Clip
from cp_env.types import SceneSource

WRITERS = {
    "v2x-sim": "cp_env.scenes.v2xsim.writer:write",
    "opv2v": "cp_env.scenes.opv2v.writer:write",
}
"""Layout to `module:function`, called with a source, the names of its scenes to write, and an empty folder."""


def export(
    source: SceneSource,
    out: Path,
    *,
    layout: str = "v2x-sim",
    names: Sequence[str] = (),
    frames: int | None = None,
    vehicles: int | None = None,
) -> Path:
    """Write scenes of `source` into the folder `out`, which must be new or empty; returns it.

    Args:
        layout: "v2x-sim" or "opv2v".
        names: the scenes; all of them by default.
        frames: only the first so many of each scene.
        vehicles: only the first so many connected vehicles of each scene have a sensor.

    Raises:
        ValueError: unknown layout or scene, a folder that is not empty, or a scene the layout has no place for.
    """
    if layout not in WRITERS:
        raise ValueError(f"unknown layout {layout!r}; known: {', '.join(WRITERS)}")
    unknown = [name for name in names if name not in source.names()]
    if unknown:
        raise ValueError(f"unknown scene {unknown[0]!r}; {source.name} holds {', '.join(source.names())}")
    out = Path(out)
    if out.exists() and any(out.iterdir()):
        raise ValueError(f"{out} is not empty; name a new folder")
    out.mkdir(parents=True, exist_ok=True)
    module, _, function = WRITERS[layout].partition(":")
    part = source if frames is None and vehicles is None else Clip(source, frames=frames, vehicles=vehicles)
    getattr(import_module(module), function)(part, tuple(names) or source.names(), out)
    return out
