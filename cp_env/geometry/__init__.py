"""Oriented boxes, planar transforms, and rigid transforms in space."""
