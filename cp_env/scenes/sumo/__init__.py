"""Scenes from SUMO's traffic, recorded or live."""
