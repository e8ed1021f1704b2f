"""What the stored records say: summaries, worst cases, curves."""

from __future__ import annotations

from cp_env.evaluation.analysis.curves import curves
from cp_env.evaluation.analysis.results import ArenaResults, collect_results
from cp_env.evaluation.analysis.summary import Row, summarise
from cp_env.evaluation.analysis.worst_case import Ranking, rank_attacks, rank_defenders

__all__ = ["ArenaResults", "Ranking", "Row", "collect_results", "curves", "rank_attacks", "rank_defenders", "summarise"]
