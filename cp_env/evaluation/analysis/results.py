"""What an arena run found: rankings, duels, curves and tables, worked out from the stored cells alone, and as JSON."""

from __future__ import annotations

import json
import zlib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from cp_env.evaluation.analysis.curves import Curve, curves
from cp_env.evaluation.analysis.summary import Row, summarise
from cp_env.evaluation.analysis.worst_case import (
    Scores,
    Standing,
    damages,
    precisions,
    rank_attackers,
    rank_defenders,
)
from cp_env.evaluation.analysis.worst_episodes import Worst, worst_episodes
from cp_env.evaluation.plan.grid import Board
from cp_env.evaluation.plan.records import write_atomically
from cp_env.evaluation.plan.runs import file_words


@dataclass(frozen=True, kw_only=True)
class Findings:
    """All that is reported. Rankings, duels and films are of the base board."""

    base: Board
    tables: Mapping[tuple[str, float, int], Sequence[Row]]  # by fusion, Δ and k
    defenders: Sequence[Standing]
    attackers: Sequence[Standing]
    damage: Scores
    ap50: Scores
    curves: Sequence[Curve]
    worst: Mapping[str, Worst]
    failed: str = ""  # which cells could not be played, and why

    @property
    def n_scenes(self) -> int:
        """How many every duel of the base has in common."""
        return len(next((scenes for by in self.damage.values() for scenes in by.values()), ()))


def find(
    boards: Sequence[Board], folder: Path, *, told: Collection[str] = (), resamples: int = 1000, failed: str = ""
) -> Findings:
    """Read what was played of the boards, the base first. `told` are defenders that know who lies (see `ranking`);
    films are, or will be, in `folder`/films."""
    played = [(board, board.played()) for board in boards]
    base, first = played[0]
    damage, ap50 = damages(base, first), precisions(base, first)
    return Findings(
        base=base,
        tables={board.point: summarise(cells, resamples=resamples) for board, cells in played},
        defenders=rank_defenders(damage, ap50, told),
        attackers=rank_attackers(damage, ap50, told),
        damage=damage,
        ap50=ap50,
        curves=curves(played),
        worst=worst_episodes(base, first, folder / "films"),
        failed=failed,
    )


def write_json(found: Findings, folder: Path, about: dict[str, Any]) -> list[Path]:
    """`arena.json` with everything, and one file for each entry in `entries`; returns all paths."""
    rows = [
        {"fusion": fusion, "budget": budget, **asdict(row)}
        for (fusion, budget, _), table in found.tables.items()
        for row in table
    ]
    whole = {
        "about": about,
        "failed": found.failed,
        "defenders": [asdict(standing) for standing in found.defenders],
        "attackers": [asdict(standing) for standing in found.attackers],
        "damage": found.damage,
        "ap50": found.ap50,
        "curves": [asdict(curve) for curve in found.curves],
        "rows": rows,
    }
    paths = [_write(folder / "arena.json", whole)]
    for role, standings in (("defender", found.defenders), ("attack", found.attackers)):
        for standing in standings:
            mine = [row for row in rows if row[role] == standing.entry]
            film = found.worst.get(standing.entry) if role == "defender" else None
            worst = None if film is None else {**asdict(film), "gif": film.gif.name}
            entry = {"role": role, **asdict(standing), "worst_episode": worst, "rows": mine, "about": about}
            name = f"{role}-{file_words(standing.entry)}-{zlib.crc32(standing.entry.encode()):08x}.json"
            paths.append(_write(folder / "entries" / name, entry))
    return paths


def with_films(found: Findings) -> Findings:
    """Only those worst episodes whose film is there."""
    return replace(found, worst={name: one for name, one in found.worst.items() if one.gif.is_file()})


def _write(path: Path, data: dict[str, Any]) -> Path:
    write_atomically(path, json.dumps(data, indent=1) + "\n")
    return path
