"""Oriented boxes, planar transforms, and rigid transforms in space."""

from __future__ import annotations

from cp_env.geometry.boxes import nms, nms_batch, pairwise_iou
from cp_env.geometry.planar import grid_origin

__all__ = ["grid_origin", "nms", "nms_batch", "pairwise_iou"]
