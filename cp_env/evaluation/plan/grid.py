"""The arena's plan: one grid for each fusion, budget and number of attackers, around a baseline or in full."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

from cp_env.evaluation.plan.records import Record, Store
from cp_env.evaluation.plan.runs import NO_ATTACK, Conditions, Run, plan_runs
from cp_env.settings import Fusion

Job = tuple[Run, Conditions, Store]
"""A run to be played, its conditions, and the store that keeps it."""


DESIGNS = ("one-factor-at-a-time", "full")
Results = dict[Run, tuple[Record, ...]]


@dataclass(frozen=True, eq=False)
class Grid:
    """Every defender against every attack under one set of conditions with k attackers, and without an attack."""

    conditions: Conditions
    k: int
    runs: tuple[Run, ...]
    store: Store

    @property
    def point(self) -> tuple[str, float, int]:
        """Fusion, Δ and k."""
        return self.conditions.fusion, self.conditions.budget, self.k

    @property
    def jobs(self) -> list[Job]:
        return [(run, self.conditions, self.store) for run in self.runs]

    def results(self) -> Results:
        """The stored results of the grid."""
        return self.store.load(self.runs, self.conditions)


@dataclass(frozen=True, kw_only=True)
class Axes:
    """The axes of a comparison. The first fusion, budget and k are the baseline, where the ranking is made.

    Args:
        defenders: specs.
        attacks: specs.
        fusions: of the detector.
        budgets: Δ.
        ks: numbers of attackers.
        seeds: of starts, attackers and noise.
        design: "one-factor-at-a-time" varies one axis at a time around the baseline; "full" plays every combination.
        off_baseline_attacks: attacks that are played away from the baseline; all by default.
        off_baseline_names: scenes that are played away from the baseline; all by default.
        batch: scenes in lock-step.

    Raises:
        ValueError: an empty or doubled axis, an unknown design, or off-baseline entries that the baseline does not
            have.
    """

    defenders: tuple[str, ...]
    attacks: tuple[str, ...]
    fusions: tuple[Fusion, ...] = ("mean",)
    budgets: tuple[float, ...] = (0.3,)
    ks: tuple[int, ...] = (2,)
    seeds: tuple[int, ...] = (0,)
    design: str = "one-factor-at-a-time"
    off_baseline_attacks: tuple[str, ...] = ()
    off_baseline_names: tuple[str, ...] = ()  # of the scenes
    batch: int = 4

    def __post_init__(self) -> None:
        if self.design not in DESIGNS:
            raise ValueError(f"unknown design {self.design!r}: choose one of {', '.join(DESIGNS)}")
        for what in ("fusions", "budgets", "ks"):
            values = getattr(self, what)
            if not values or len(set(values)) != len(values):
                raise ValueError(f"{what} must be distinct, and at least one; got {list(values)}")
        strange = sorted(set(self.off_baseline_attacks) - set(self.attacks))
        if strange:
            raise ValueError(f"attacks {strange} are to play off the baseline, but not at it; name them among all")

    @property
    def points(self) -> list[tuple[Fusion, float, int]]:
        """Fusion, Δ and k of every grid, the baseline first."""
        fusion, budget, k = self.fusions[0], self.budgets[0], self.ks[0]
        if self.design == "full":
            return list(product(self.fusions, self.budgets, self.ks))
        arms = [
            *((fusion, budget, other) for other in self.ks),
            *((fusion, other, k) for other in self.budgets),
            *((other, budget, k) for other in self.fusions),
        ]
        return list(dict.fromkeys(arms))

    def grids(self, conditions: Conditions, stores: dict[str, Store]) -> list[Grid]:
        """The grids, the baseline first.

        Args:
            conditions: of the baseline.
            stores: by fusion.

        Raises:
            ValueError: a grid that cannot be planned (see `plan_runs`).
        """
        grids = []
        for number, (fusion, budget, k) in enumerate(self.points):
            names = conditions.names if number == 0 else self.off_baseline_names or conditions.names
            attacks = self.attacks if number == 0 else self.off_baseline_attacks or self.attacks
            here = replace(conditions, fusion=fusion, budget=budget, names=names)
            runs = plan_runs(
                here,
                defenders=self.defenders,
                attacks=tuple(dict.fromkeys([NO_ATTACK, *attacks])),
                ks=(k,),
                seeds=self.seeds,
                batch=self.batch,
            )
            grids.append(Grid(here, k, tuple(runs), stores[fusion]))
        return grids


def jobs_of(grids: Sequence[Grid]) -> list[Job]:
    """Every run once, though grids may share it."""
    jobs = {store.path(run, conditions): (run, conditions, store) for b in grids for run, conditions, store in b.jobs}
    return list(jobs.values())
