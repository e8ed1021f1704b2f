"""A world without a detector, in which verifications are right with a given probability."""

from __future__ import annotations

from defenders.simulation.statistics import EpisodeStats, play_many
from defenders.simulation.verifier import ErrorRates, Measured
from defenders.simulation.world import Scenario, SimulatedWorld, play

__all__ = ["EpisodeStats", "ErrorRates", "Measured", "Scenario", "SimulatedWorld", "play", "play_many"]
