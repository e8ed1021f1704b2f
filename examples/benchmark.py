"""Defenders × attacks × numbers of attackers on test scenes, on equal terms: one table with error bars and costs.

    python examples/benchmark.py --small                                        # a few minutes; also: cp-benchmark
    python examples/benchmark.py --ks 1 2 3 4 --seeds 0 1 2 --workers 2 --out out/benchmark

The program `cp-benchmark` on one page: plan, play, write, show. Copy it where you need another table.
"""

from __future__ import annotations

import shlex
import sys

import tyro
from rich.console import Console

from agents.commands.benchmark import Args, film, plan, play, write
from cp_env import evaluation
from cp_env.evaluation.report.benchmark import GLOSSARY


def main(args: Args) -> None:
    console = Console()
    conditions, runs = plan(args)  # every defender against every attack, some scenes in lock-step
    results = play(args, conditions, runs, console)  # what `args.out` holds already is not played again
    rows = evaluation.summarise(results)  # one a defender, attack and k
    paths = write(args, conditions, results, shlex.join(["python", *sys.argv]))
    console.print(evaluation.screen(rows), "means (intervals are in the files)", GLOSSARY, sep="\n", highlight=False)
    console.print("written:", *paths)
    if args.gif:
        console.print("video:  ", film(args, conditions))


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__).cut())
