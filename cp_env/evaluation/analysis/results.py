"""Results of an arena: rankings, pairwise results, curves and rows, from the stored runs alone, and as JSON."""

from __future__ import annotations

import json
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from cp_env.evaluation.analysis.curves import Curve, curves
from cp_env.evaluation.analysis.flags import better_than_everyone
from cp_env.evaluation.analysis.summary import Row, summarise
from cp_env.evaluation.analysis.worst_case import (
    Ranking,
    Scores,
    average_precisions,
    damages,
    rank_attacks,
    rank_defenders,
)
from cp_env.evaluation.analysis.worst_episodes import Worst, worst_episodes
from cp_env.evaluation.plan.files import write_atomically
from cp_env.evaluation.plan.grid import Grid
from cp_env.evaluation.plan.runs import file_words


@dataclass(frozen=True, kw_only=True)
class ArenaResults:
    """All that is reported. Rankings, pairwise results and videos are of the baseline grid."""

    baseline: Grid
    rows_at: Mapping[tuple[str, float, int], Sequence[Row]]  # by fusion, Δ and k
    defenders: Sequence[Ranking]
    attacks: Sequence[Ranking]
    damage: Scores
    ap50: Scores
    curves: Sequence[Curve]
    worst: Mapping[str, Worst]
    failed: str = ""  # which runs could not be played, and why
    flags: Sequence[str] = ()  # what no defender should reach

    @property
    def n_scenes(self) -> int:
        """Number of scenes that every pair of the baseline has played."""
        return len(next((scenes for by in self.damage.values() for scenes in by.values()), ()))


def collect_results(grids: Sequence[Grid], folder: Path, *, resamples: int = 1000, failed: str = "") -> ArenaResults:
    """Read the results of the grids, the baseline first.

    Args:
        grids: the baseline first.
        folder: of the arena; videos are, or will be, in `folder`/videos.
        resamples: of the bootstrap.
        failed: the runs that could not be played, and why.
    """
    results = [(grid, grid.results()) for grid in grids]
    baseline, first = results[0]
    informed = {
        run.defender for _, runs in results for run, records in runs.items() if any(r.informed for r in records)
    }
    damage, ap50 = damages(baseline, first), average_precisions(baseline, first)
    rows_at = {grid.point: summarise(runs, resamples=resamples) for grid, runs in results}
    return ArenaResults(
        baseline=baseline,
        rows_at=rows_at,
        flags=tuple(better_than_everyone(rows_at[baseline.point])),
        defenders=rank_defenders(damage, ap50, informed),
        attacks=rank_attacks(damage, ap50, informed),
        damage=damage,
        ap50=ap50,
        curves=curves(results),
        worst=worst_episodes(baseline, first, folder / "videos"),
        failed=failed,
    )


def write_json(results: ArenaResults, folder: Path, about: dict[str, Any]) -> list[Path]:
    """Write `arena.json` with everything, and one file for each entry in `entries`; returns all paths."""
    rows = [
        {"fusion": fusion, "budget": budget, **asdict(row)}
        for (fusion, budget, _), table in results.rows_at.items()
        for row in table
    ]
    whole = {
        "about": about,
        "failed": results.failed,
        "flags": results.flags,
        "defenders": [asdict(ranking) for ranking in results.defenders],
        "attacks": [asdict(ranking) for ranking in results.attacks],
        "damage": results.damage,
        "ap50": results.ap50,
        "curves": [asdict(curve) for curve in results.curves],
        "rows": rows,
    }
    paths = [_write(folder / "arena.json", whole)]
    for role, rankings in (("defender", results.defenders), ("attack", results.attacks)):
        for ranking in rankings:
            mine = [row for row in rows if row[role] == ranking.entry]
            video = results.worst.get(ranking.entry) if role == "defender" else None
            worst = None if video is None else {**asdict(video), "gif": video.gif.name}
            entry = {"role": role, **asdict(ranking), "worst_episode": worst, "rows": mine, "about": about}
            name = f"{role}-{file_words(ranking.entry)}-{zlib.crc32(ranking.entry.encode()):08x}.json"
            paths.append(_write(folder / "entries" / name, entry))
    return paths


def with_videos(results: ArenaResults) -> ArenaResults:
    """Only those worst episodes whose video is there."""
    return replace(results, worst={name: one for name, one in results.worst.items() if one.gif.is_file()})


def _write(path: Path, data: dict[str, Any]) -> Path:
    write_atomically(path, json.dumps(data, indent=1) + "\n")
    return path
