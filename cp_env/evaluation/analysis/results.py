"""Results of an arena: rankings, pairwise results, curves and rows, from the stored runs alone, and as JSON."""

from __future__ import annotations

import json
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from cp_env.evaluation.analysis.comparisons import Difference
from cp_env.evaluation.analysis.curves import Curve, curves
from cp_env.evaluation.analysis.failed_episodes import failed_episodes
from cp_env.evaluation.analysis.flags import better_than_everyone
from cp_env.evaluation.analysis.measures import headlines, measure_of
from cp_env.evaluation.analysis.strata import Stratum, strata
from cp_env.evaluation.analysis.summary import Row, summarise
from cp_env.evaluation.analysis.worst_case import (
    Ranking,
    Scores,
    compare_defenders,
    measured,
    rank_attacks,
    rank_defenders,
    screened_attacks,
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
    strata: Sequence[Stratum]  # of the baseline: the ego benign, the ego an attacker
    defenders: Sequence[Ranking]  # by the first measure
    attacks: Sequence[Ranking]
    further: Mapping[str, Sequence[Ranking]]  # defenders by each further measure
    differences: Sequence[Difference]  # of all pairs of defenders that have a rank, in the first measure
    scores: Mapping[str, Scores]  # by measure
    curves: Sequence[Curve]
    worst: Mapping[str, Worst]
    failed: str = ""  # which runs could not be played, and why
    ended: Sequence[str] = ()  # which defenders failed and ended episodes, how often, and why
    flags: Sequence[str] = ()  # what no defender should reach
    by: str = "damage"  # the measure that ranks
    screening: Grid | None = None  # the grid on which each defender's attack was picked

    @property
    def n_scenes(self) -> int:
        """Number of scenes that every pair of the baseline has played."""
        return len(next((scenes for by in self.scores[self.by].values() for scenes in by.values()), ()))

    @property
    def damage(self) -> Scores:
        return self.scores["damage"]

    @property
    def ap50(self) -> Scores:
        return self.scores["ap50"]


def collect_results(
    grids: Sequence[Grid],
    folder: Path,
    *,
    resamples: int = 1000,
    failed: str = "",
    rank_by: Sequence[str] = ("damage", "critical_recall"),
    screening: Grid | None = None,
) -> ArenaResults:
    """Read the results of the grids, the baseline first.

    Args:
        grids: the baseline first.
        folder: of the arena; videos are, or will be, in `folder`/videos.
        resamples: Dirichlet weights of the intervals of AP.
        failed: the runs that could not be played, and why.
        rank_by: the measure that ranks defenders and attacks, and further ones that rank defenders.
        screening: a grid of other scenes, on which the attack is picked under which each defender is ranked.

    Raises:
        ValueError: no measure, or one that is not known.
    """
    if not rank_by:
        raise ValueError("a ranking needs a measure, such as damage; got none")
    by, *others = dict.fromkeys(measure_of(name).name for name in rank_by)
    results = [(grid, grid.results()) for grid in grids]
    baseline, first = results[0]
    shown = tuple(dict.fromkeys([*headlines(), by, *others]))
    tables = measured(baseline, first, shown)
    screens = None if screening is None else measured(screening, screening.results(), shown)
    screened = {m: None if screens is None else screened_attacks(screens[m], m, tables[m]) for m in (by, *others)}
    informed = {
        run.defender for _, runs in results for run, records in runs.items() if any(r.informed for r in records)
    }
    ranked = {defender: of for defender, of in tables[by].items() if defender not in informed}
    rows_at = {grid.point: summarise(runs, resamples=resamples) for grid, runs in results}
    return ArenaResults(
        baseline=baseline,
        rows_at=rows_at,
        flags=tuple(better_than_everyone(rows_at[baseline.point])),
        strata=strata(first, resamples=resamples),
        defenders=rank_defenders(tables, informed, by=by, screened=screened[by]),
        attacks=rank_attacks(tables, informed, by=by),
        further={m: rank_defenders(tables, informed, by=m, screened=screened[m]) for m in others},
        differences=compare_defenders(ranked, by, screened[by]),
        scores=tables,
        curves=curves(results, None if screens is None else screens["damage"]),
        worst=worst_episodes(baseline, first, folder / "videos"),
        failed=failed,
        ended=failed_episodes([runs for _, runs in results]),
        by=by,
        screening=screening,
    )


def write_json(results: ArenaResults, folder: Path, about: dict[str, Any]) -> list[Path]:
    """Write `arena.json` with everything, and one file for each entry in `entries`; returns all paths."""
    rows = [
        {"fusion": fusion, "budget": budget, **row.to_json()}
        for (fusion, budget, _), table in results.rows_at.items()
        for row in table
    ]
    whole = {
        "about": about,
        "failed": results.failed,
        "failed_episodes": results.ended,
        "flags": results.flags,
        "ranked_by": results.by,
        "screening": None if results.screening is None else results.screening.conditions.describe(),
        "defenders": [ranking.to_json() for ranking in results.defenders],
        "attacks": [ranking.to_json() for ranking in results.attacks],
        "further_rankings": {m: [ranking.to_json() for ranking in of] for m, of in results.further.items()},
        "differences": [asdict(difference) for difference in results.differences],
        **results.scores,
        "curves": [asdict(curve) for curve in results.curves],
        "rows": rows,
        "strata": {stratum.name: [row.to_json() for row in stratum.rows] for stratum in results.strata},
    }
    paths = [_write(folder / "arena.json", whole)]
    for role, rankings in (("defender", results.defenders), ("attack", results.attacks)):
        for ranking in rankings:
            mine = [row for row in rows if row[role] == ranking.entry]
            video = results.worst.get(ranking.entry) if role == "defender" else None
            worst = None if video is None else {**asdict(video), "gif": video.gif.name}
            entry = {"role": role, **ranking.to_json(), "worst_episode": worst, "rows": mine, "about": about}
            name = f"{role}-{file_words(ranking.entry)}-{zlib.crc32(ranking.entry.encode()):08x}.json"
            paths.append(_write(folder / "entries" / name, entry))
    return paths


def with_videos(results: ArenaResults) -> ArenaResults:
    """Only those worst episodes whose video is there."""
    return replace(results, worst={name: one for name, one in results.worst.items() if one.gif.is_file()})


def _write(path: Path, data: dict[str, Any]) -> Path:
    write_atomically(path, json.dumps(data, indent=1) + "\n")
    return path
