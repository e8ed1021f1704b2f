"""ROBOSAC's two formulas for tries and team size, and the success rate of its sampling.

    python examples/reproduce/robosac_budget.py

N = ⌈ln 0.01 / ln(1-(1-η)^s)⌉ tries find a clean team of s with 99 % confidence if every try draws each vehicle anew and
a share η of the vehicles is malicious. s = ⌊ln(1-0.01^(1/N)) / ln(1-η)⌋ is the largest team for a budget of N. The code
of ROBOSAC draws teams without replacement: C(n-k, s) of C(n, s) teams are clean. `Robosac` plays every frame under a
perfect verifier with a benign ego. "found" is the share of frames with a team, with its 95 % interval, and "exact" is
its expectation. "verifications/frame" is the mean number of tries. A budget that allows no team at all (s < 1) is an
error. One that allows more than n - k vehicles is cut to n - k.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import tyro
from rich.console import Console
from rich.table import Table

from cp_env.metrics.shares import share_interval
from defenders import Robosac
from defenders.robosac import team_size
from defenders.simulation.statistics import play_many
from defenders.simulation.world import Scenario


@dataclass(frozen=True)
class Args:
    n: int = 5
    """collaborators of the ego, without the ego"""
    budgets: tuple[int, ...] = (3, 5, 10, 20)
    frames: int = 4000
    seed: int = 0


def row(reading: str, k: int, budget: int, args: Args) -> list[str]:
    """A row of either table: k, budget, team size, found, exact, verifications in a frame."""
    defender = Robosac(reading=reading, n_attackers=k, budget=budget)
    scenario = Scenario(n_vehicles=args.n + 1, n_attackers=k, benign={0}, max_frames=100)
    try:
        stats = play_many(defender, scenario, episodes=math.ceil(args.frames / 100), seed=args.seed)
    except ValueError:
        return [str(k), str(budget), "0", "–", "refused", "", ""]
    found = (stats.fused != 1).mean(axis=1)  # a team besides vehicle 0
    clean = math.comb(args.n - k, defender.size) / math.comb(args.n, defender.size)
    exact = 1 - (1 - clean) ** defender.tries
    cells = f"{share_interval(found):.3f}", f"{exact:.3f}", f"{stats.verifications.mean():.2f}"
    affordable = team_size(k / args.n, defender.tries, defender.confidence)
    return [str(k), str(defender.tries), f"{affordable:.0f}", str(defender.size), *cells]


def main(args: Args) -> None:
    console = Console(width=110)
    columns = ("k", "N", "s by formula", "s", "found", "exact", "verifications/frame")
    full = Table(*columns, title=f'reading "replacement": everyone but the attackers, n = {args.n}')
    for k in range(1, args.n):
        full.add_row(*row("replacement", k, 1, args))
    budgeted = Table(*columns, title=f'reading "budgeted": the largest team a budget affords, n = {args.n}')
    for k in range(1, args.n):
        for budget in args.budgets:
            budgeted.add_row(*row("budgeted", k, budget, args), end_section=budget == args.budgets[-1])
    console.print(full, budgeted, sep="\n")


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
