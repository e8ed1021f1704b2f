"""Similarity thresholds that ship, by group size."""
