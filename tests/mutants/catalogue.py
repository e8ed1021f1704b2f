"""All mutants, by room."""

from __future__ import annotations

from tests.mutants.mutant import Mutant
from tests.mutants.rooms import bayes, boxes, metrics, perturbation, prbi, similarity, statistics, verification, world

ROOMS: dict[str, tuple[Mutant, ...]] = {
    "perturbation": perturbation.MUTANTS,
    "world": world.MUTANTS,
    "verification": verification.MUTANTS,
    "similarity": similarity.MUTANTS,
    "boxes": boxes.MUTANTS,
    "metrics": metrics.MUTANTS,
    "statistics": statistics.MUTANTS,
    "prbi": prbi.MUTANTS,
    "bayes": bayes.MUTANTS,
}

CATALOGUE = tuple(mutant for room in ROOMS.values() for mutant in room)
