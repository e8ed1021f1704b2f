"""Sources of scenes. A source is opened by its name, a string; objects are accepted everywhere."""

from __future__ import annotations

import errno
import sys
from importlib import import_module
from importlib.util import find_spec

from cp_env.scenes.pooled import Pooled
from cp_env.scenes.spec import PathSpec
from cp_env.scenes.town import FAMILIES, KINDS, SPLITS, Junction, Town
from cp_env.types import SceneSource
from defenders.registry import Registry, Spec, shown, unknown

__all__ = ["FAMILIES", "KINDS", "SCENES", "SOURCES", "SPLITS", "Junction", "Town", "open_source"]

SOURCES = {
    "v2x-sim": "cp_env.scenes.v2xsim.source:V2XSim",
    "v2x-sim-det": "cp_env.scenes.v2xsim.preprocessed:V2XSimDet",
    "opv2v": "cp_env.scenes.opv2v.source:OPV2V",
    "v2v4real": "cp_env.scenes.opv2v.v2v4real:V2V4Real",
    "v2x-real": "cp_env.scenes.opv2v.v2x_real:V2XReal",
    "dair-v2x": "cp_env.scenes.dair_v2x.source:DairV2X",
    "nuscenes": "cp_env.scenes.nuscenes.source:NuScenes",
    "sumo": "cp_env.scenes.sumo.live:LiveSumo",
}
"""Sources with a path: kind to `module:class`, imported when first opened. The class takes the path, then keywords."""

SCENES: Registry[SceneSource] = Registry(
    "source of scenes", dict(FAMILIES), SceneSource, methods=(("names", "load", "sweeps"),)
)
"""Sources without a path, and `module:Class` for yours."""


def open_source(spec: str | SceneSource) -> SceneSource:
    """The source that `spec` names; a source itself is handed back.

    Args:
        spec: "town" (its training split), "town/train", "town/calibration", "town/test"; "junction" likewise; several
            of those joined by "+", as one source; a kind of `SOURCES`, a path and options, such as
            "v2x-sim:/data/V2X-Sim-2.0?split=test&scenes=5,8"; "module:Class" of yours, with options as
            "module:Class:option=value"; or an object.

    Returns:
        The source.

    Raises:
        ValueError: unknown name, kind or option (with the nearest known one), an object that is no source, or a broken
            data set.
    """
    if not isinstance(spec, str):
        if not isinstance(spec, SceneSource):
            raise ValueError(
                f"scenes must be a name or a SceneSource (name, digest, names, load, sweeps); got {shown(spec)}"
            )
        return spec
    if spec.partition(":")[0] in SOURCES:
        return _open(PathSpec.parse(spec))
    parts = spec.split("+")
    if len(parts) > 1 and all(part.partition("/")[0] in FAMILIES for part in parts):
        return Pooled([open_source(part) for part in parts])
    family, _, split = spec.partition("/")
    if family == "town" and split in SPLITS:
        return Town(split)
    if family == "junction" and split in SPLITS:
        return Junction(split)
    name = Spec.parse(spec)
    if name.name not in SCENES.entries and (name.place is None or not _is_module(name.place[0])):
        shipped = [text for family in FAMILIES for text in (family, *(f"{family}/{split}" for split in SPLITS))]
        known = [*shipped, *(f"{kind}:PATH" for kind in SOURCES), "module:Class"]
        where = f" (there is no module {name.place[0]!r})" if name.place else ""
        raise ValueError(f"{unknown('scenes', spec, known)}{where}")
    return SCENES.make(spec)


def _is_module(name: str) -> bool:
    """Whether the package that the name begins with can be found; nothing is imported."""
    return name in sys.modules or find_spec(name.partition(".")[0] or " ") is not None


def _open(spec: PathSpec) -> SceneSource:
    module, _, attribute = SOURCES[spec.kind].partition(":")
    try:
        source: SceneSource = spec.open(getattr(import_module(module), attribute))
    except OSError as error:
        if error.errno != errno.ENAMETOOLONG:
            raise
        raise ValueError(f"{spec.kind} scenes at {shown(spec.path)}: no path can be so long") from error
    return source
