"""The leaderboard: an arena's report as a page of the documentation, with its plots in a folder of the same name."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cp_env.evaluation.analysis.results import ArenaResults
from cp_env.evaluation.plan.files import write_atomically
from cp_env.evaluation.report.arena import write_markdown

TITLES = {"defenders": "defenders", "attacks": "attacks", "ap50": "trade-off"}
"""The plot under each table."""


def write_leaderboard(results: ArenaResults, drawn: Mapping[str, str], page: Path, about: dict[str, Any]) -> Path:
    """Write `page`, a Markdown file, and the folder of its name: plots, and the worst episode of the best defender."""
    folder, links = page.with_suffix(""), {}
    under = {picture: table for table, picture in TITLES.items()}
    for name, svg in drawn.items():
        write_atomically(folder / f"{name}.svg", svg)
        links[under.get(name, name)] = f"{folder.name}/{name}.svg"
    best = next((ranking.entry for ranking in results.defenders if ranking.entry in results.worst), None)
    if best is not None:
        write_atomically(folder / "worst.gif", results.worst[best].gif.read_bytes())
        links[f"{best}, the best ranked, in its worst episode"] = f"{folder.name}/worst.gif"
    return write_markdown(results, page, about, links, "Leaderboard")
