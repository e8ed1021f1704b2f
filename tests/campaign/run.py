"""The campaign: kills, hostile inputs, a soak, sharing, equal trajectories, and reports in a browser, for hours.

    python -m tests.campaign.run                                  # everything, at full length
    python -m tests.campaign.run --parts kills inputs --kills 10 --inputs 50_000
    python -m tests.campaign.run --parts --page docs/reliability.md   # nothing is tried: the tables are written again

What was tried is kept in `out/campaign/results.jsonl`, case by case. A campaign that was interrupted goes on; a case is
tried again if its claim did not hold, or if the code has changed since. The exit status is 1 if a claim does not hold.
"""

from __future__ import annotations

import shutil
import signal
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import tyro
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from tests.campaign import equality, fuzz, kills, pages, sharing, soak
from tests.campaign.case import Case, Result, try_case
from tests.campaign.ledger import Ledger, code_digest
from tests.campaign.processes import ROOT
from tests.campaign.report import write_tables

PARTS = (kills.PART, fuzz.PART, soak.PART, sharing.PART, equality.PART, pages.PART)


@dataclass(frozen=True)
class Args:
    """Options of the program."""

    parts: tuple[str, ...] = PARTS
    """which parts, in this order"""
    kills: int = 100
    inputs: int = 1_000_000
    minutes: float = 30.0
    """of the soak that lasts so long"""
    resets: int = 10_000
    """of the soak that lasts until so many"""
    scenes: str = "town/test"
    """of the soak of minutes and of equal trajectories; or "toy", which need no detector of the size of ours"""
    seed: int = 0
    only: tuple[str, ...] = ()
    """those cases whose name holds one of these texts, as "chain 4,"; all by default"""
    again: bool = False
    """try cases again that held"""
    out: Path = ROOT / "out/campaign"
    page: Path | None = None
    """a page whose tables are written again"""
    any_code: bool = False
    """what held on other code counts, and the page tells of it: for tables alone"""


def planned(args: Args) -> list[Case]:
    """The cases of the parts. ValueError for a part that is not known, or if no case has such a name."""
    if unknown := sorted(set(args.parts) - set(PARTS)):
        raise ValueError(f"unknown parts {', '.join(unknown)}; the parts are {', '.join(PARTS)}")
    cases = {
        kills.PART: lambda: kills.cases(args.kills, args.seed),
        fuzz.PART: lambda: fuzz.cases(args.inputs, args.seed),
        soak.PART: lambda: soak.cases(args.minutes, args.resets, args.scenes, args.seed),
        sharing.PART: lambda: sharing.cases(args.seed),
        equality.PART: lambda: equality.cases(args.seed, scenes=args.scenes),
        pages.PART: lambda: pages.cases(),
    }
    every = [case for part in args.parts for case in cases[part]()]
    chosen = [case for case in every if not args.only or any(text in case.name for text in args.only)]
    if every and not chosen:
        raise ValueError(f"no case's name holds {' or '.join(map(repr, args.only))}, but {every[0].name!r} is one")
    return chosen


def campaign(cases: Sequence[Case], ledger: Ledger, code: str, work: Path, console: Console) -> list[Result]:
    """Try the cases whose results are not known yet, and keep each result at once. Returns the results of all."""
    results = []
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, TextColumn("{task.fields[last]}"), console=console) as bars:
        tasks = {part: bars.add_task(part, total=0, last="") for part in dict.fromkeys(case.part for case in cases)}
        for case in cases:
            bars.update(tasks[case.part], total=sum(other.part == case.part for other in cases))
        for number, case in enumerate(cases):
            result = ledger.known(case.part, case.name, code)
            if result is None:
                bars.update(tasks[case.part], last=case.name)
                folder = work / str(number)
                result = try_case(case, folder, code)
                ledger.add(result)
                shutil.rmtree(folder, ignore_errors=True)
                if not result.holds:
                    console.print(f"[bold red]does not hold[/] {case.part}: {case.name}\n{result.why}", highlight=False)
            results.append(result)
            bars.update(tasks[case.part], advance=1, last="")
    return results


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program. Returns its exit status."""
    args = tyro.cli(Args, args=argv, description=__doc__)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))  # so that what it started ends with it
    cases, console, code = planned(args), Console(), code_digest(ROOT)
    ledger = Ledger(args.out / "results.jsonl")
    if args.again:
        for case in cases:
            ledger.results.pop((case.part, case.name), None)
    with tempfile.TemporaryDirectory(prefix="cp-env-campaign-") as work:
        results = campaign(cases, ledger, code, Path(work), console)
    failed = [result for result in results if not result.holds]
    console.print(f"{len(results) - len(failed)} claims hold, {len(failed)} do not: {args.out / 'results.jsonl'}")
    if args.page is not None:
        chosen = ledger.codes() if args.any_code else (code,)
        write_tables(args.page, [result for result in ledger.results.values() if result.code in chosen])
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
