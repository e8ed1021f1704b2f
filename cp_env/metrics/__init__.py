"""Measures of a frame and of an episode: average precision, similarity, identification, intervals."""

from __future__ import annotations

from cp_env.metrics.average_precision import RULES, ApMeter, average_precision
from cp_env.metrics.identification import id_rate, mc_rate, recovery
from cp_env.metrics.similarity import jaccard, view_similarity

__all__ = ["RULES", "ApMeter", "average_precision", "id_rate", "jaccard", "mc_rate", "recovery", "view_similarity"]
