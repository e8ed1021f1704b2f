"""Layouts differ in what their pages say."""

from __future__ import annotations

from cp_env.scenes import SOURCES
from cp_env.scenes.opv2v.layouts import OPV2V, V2V4REAL, V2X_REAL


def test_each_is_opened_by_its_kind_and_has_a_time_among_those_of_a_count() -> None:
    for layout in (OPV2V, V2V4REAL, V2X_REAL):
        assert layout.kind in SOURCES and layout.tick in layout.counts
    assert not OPV2V.right_handed and V2V4REAL.local_boxes and not V2X_REAL.local_boxes
