"""Where scenes come from. A source is named by a string at the outer door; objects are accepted everywhere."""

from __future__ import annotations

from importlib import import_module

from cp_env.scenes.spec import Spec
from cp_env.scenes.town import KINDS, SPLITS, Town
from cp_env.types import SceneSource

__all__ = ["KINDS", "SOURCES", "SPLITS", "Town", "open_source"]

SOURCES = {
    "v2x-sim": "cp_env.scenes.v2xsim.source:V2XSim",
    "v2x-sim-det": "cp_env.scenes.v2xsim.preprocessed:V2XSimDet",
    "opv2v": "cp_env.scenes.opv2v.source:OPV2V",
    "sumo": "cp_env.scenes.sumo.live:LiveSumo",
}
"""Sources with a path: kind to `module:class`, imported when first opened. The class takes the path, then keywords."""


def open_source(spec: str | SceneSource) -> SceneSource:
    """The source that `spec` names; a source itself is handed back.

    Args:
        spec: "town" (its training split), "town/train", "town/calibration", "town/test"; a kind of `SOURCES`, a path
            and options, such as "v2x-sim:/data/V2X-Sim-2.0?split=test&scenes=5,8"; or an object.

    Raises:
        ValueError: unknown name, kind or option, an object that is no source, or a broken data set.
    """
    if not isinstance(spec, str):
        if not isinstance(spec, SceneSource):
            raise ValueError(
                f"scenes must be a name or a SceneSource (name, digest, names, load, sweeps); got {spec!r}"
            )
        return spec
    if spec.partition(":")[0] in SOURCES:
        return _open(Spec.parse(spec))
    family, _, split = spec.partition("/")
    if family != "town" or (split or "train") not in SPLITS:
        known = ", ".join(["town", *(f"town/{name}" for name in SPLITS), *(f"{kind}:PATH" for kind in SOURCES)])
        raise ValueError(f"unknown scenes {spec!r}; known: {known}")
    return Town(split or "train")


def _open(spec: Spec) -> SceneSource:
    module, _, attribute = SOURCES[spec.kind].partition(":")
    source: SceneSource = spec.open(getattr(import_module(module), attribute))
    return source
