"""The leaderboard: a run's report as a page of the documentation, with its pictures in a folder beside it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cp_env.evaluation.analysis.results import Findings
from cp_env.evaluation.plan.records import write_atomically
from cp_env.evaluation.report.arena import write_markdown

TITLES = {"defenders": "defenders", "attackers": "attackers", "ap50": "trade-off"}
"""Which picture stands under which table."""


def write_leaderboard(found: Findings, drawn: Mapping[str, str], page: Path, about: dict[str, Any]) -> Path:
    """`page`, a Markdown file, and the folder of its name: `pictures`, and the worst episode of the best defender."""
    folder, links = page.with_suffix(""), {}
    under = {picture: table for table, picture in TITLES.items()}
    for name, svg in drawn.items():
        write_atomically(folder / f"{name}.svg", svg)
        links[under.get(name, name)] = f"{folder.name}/{name}.svg"
    best = next((standing.entry for standing in found.defenders if standing.entry in found.worst), None)
    if best is not None:
        write_atomically(folder / "worst.gif", found.worst[best].gif.read_bytes())
        links[f"{best}, the best ranked, in the episode in which its ego lost the most"] = f"{folder.name}/worst.gif"
    return write_markdown(found, page, about, links, "Leaderboard")
