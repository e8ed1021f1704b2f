"""The arena's plan: one board for each fusion, budget and number of liars, all of them around one point or in full."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

from cp_env.evaluation.plan.records import Record, Store
from cp_env.evaluation.plan.runs import NOBODY, Cell, Protocol, plan

Turn = tuple[Cell, Protocol, Store]
"""A cell to be played, under which conditions, and where it is kept."""


DESIGNS = ("star", "full")
Played = dict[Cell, tuple[Record, ...]]


@dataclass(frozen=True, eq=False)
class Board:
    """Every defender against every attack under one set of conditions with k liars, and against nobody."""

    protocol: Protocol
    k: int
    cells: tuple[Cell, ...]
    store: Store

    @property
    def point(self) -> tuple[str, float, int]:
        """Fusion, Δ and k."""
        return self.protocol.fusion, self.protocol.budget, self.k

    @property
    def turns(self) -> list[Turn]:
        return [(cell, self.protocol, self.store) for cell in self.cells]

    def played(self) -> Played:
        """What the store holds of it."""
        return self.store.load(self.cells, self.protocol)


@dataclass(frozen=True, kw_only=True)
class Axes:
    """What is varied. The first fusion, budget and k are the base point, where the ranking is made.

    A "star" varies one of them at a time around the base, a "full" design plays every combination. Away from the base,
    only `side_attacks` and `side_names` are played, if they are given.

    Raises ValueError for an empty or doubled axis, an unknown design, and side entries that the base has not.
    """

    defenders: tuple[str, ...]
    attacks: tuple[str, ...]
    fusions: tuple[str, ...] = ("mean",)
    budgets: tuple[float, ...] = (0.3,)
    ks: tuple[int, ...] = (2,)
    seeds: tuple[int, ...] = (0,)
    design: str = "star"
    side_attacks: tuple[str, ...] = ()
    side_names: tuple[str, ...] = ()  # of the scenes
    batch: int = 4

    def __post_init__(self) -> None:
        if self.design not in DESIGNS:
            raise ValueError(f"unknown design {self.design!r}: choose one of {', '.join(DESIGNS)}")
        for what in ("fusions", "budgets", "ks"):
            values = getattr(self, what)
            if not values or len(set(values)) != len(values):
                raise ValueError(f"{what} must be distinct, and at least one; got {list(values)}")
        strange = sorted(set(self.side_attacks) - set(self.attacks))
        if strange:
            raise ValueError(f"attacks {strange} are to play beside the base, but not at it; name them among all")

    @property
    def points(self) -> list[tuple[str, float, int]]:
        """Fusion, Δ and k of every board, the base first."""
        fusion, budget, k = self.fusions[0], self.budgets[0], self.ks[0]
        if self.design == "full":
            return list(product(self.fusions, self.budgets, self.ks))
        arms = [
            *((fusion, budget, other) for other in self.ks),
            *((fusion, other, k) for other in self.budgets),
            *((other, budget, k) for other in self.fusions),
        ]
        return list(dict.fromkeys(arms))

    def boards(self, protocol: Protocol, stores: dict[str, Store]) -> list[Board]:
        """The boards, the base first; `stores` by fusion. ValueError for what cannot be planned (see `plan`)."""
        boards = []
        for number, (fusion, budget, k) in enumerate(self.points):
            names = protocol.names if number == 0 else self.side_names or protocol.names
            attacks = self.attacks if number == 0 else self.side_attacks or self.attacks
            here = replace(protocol, fusion=fusion, budget=budget, names=names)
            cells = plan(
                here,
                defenders=self.defenders,
                attacks=tuple(dict.fromkeys([NOBODY, *attacks])),
                ks=(k,),
                seeds=self.seeds,
                batch=self.batch,
            )
            boards.append(Board(here, k, tuple(cells), stores[fusion]))
        return boards


def turns_of(boards: Sequence[Board]) -> list[Turn]:
    """Every cell once, though boards may share it."""
    turns = {store.path(cell, protocol): (cell, protocol, store) for b in boards for cell, protocol, store in b.turns}
    return list(turns.values())
