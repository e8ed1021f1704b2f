"""Tables, told once and written as Markdown or as a part of a page: rankings, duels, curves and all figures."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from cp_env.evaluation.analysis.curves import Curve
from cp_env.evaluation.analysis.summary import Row
from cp_env.evaluation.analysis.worst_case import Scores, Standing
from cp_env.evaluation.plan.runs import NOBODY
from cp_env.evaluation.report.benchmark import COLUMNS, figure_text
from cp_env.metrics.intervals import Interval


@dataclass(frozen=True)
class Entry:
    """One cell of a table: what is shown, what it is sorted by, and how strongly it is shaded (0 to 1)."""

    text: str
    value: float | None = None
    shade: float | None = None


@dataclass(frozen=True)
class Heading:
    """One column. Those of numbers are set flush right and sorted as numbers."""

    text: str
    number: bool = True


@dataclass(frozen=True)
class Sheet:
    """A table."""

    headings: Sequence[Heading]
    rows: Sequence[Sequence[Entry]]
    caption: str = field(default="")

    def markdown(self) -> str:
        """The same in Markdown; the caption stands below it."""
        head = "| " + " | ".join(_plain(heading.text) for heading in self.headings) + " |"
        rule = "|" + "".join("--:|" if heading.number else "---|" for heading in self.headings)
        body = ["| " + " | ".join(_plain(entry.text) for entry in row) + " |" for row in self.rows]
        return "\n".join([head, rule, *body, *(["", self.caption] if self.caption else [])]) + "\n"


def defender_ranking(standings: Sequence[Standing], rows: Sequence[Row]) -> Sheet:
    """Defenders by their worst case, with what they cost when nobody lies."""
    headings = [
        *_ranked("defender", "worst attack"),
        Heading("AP@.5, nobody lies"),
        Heading("looks/frame, dearest attack"),
        Heading("failed"),
    ]
    lines = []
    for standing in standings:
        mine = [row for row in rows if row.defender == standing.entry]
        clean = next((row.ap50 for row in mine if row.attack == NOBODY), None)
        dearest = max((row.verifications for row in mine), key=lambda looks: looks.mean, default=None)
        failed = sum(row.n_errors for row in mine)
        entries = [_interval(clean), _interval(dearest, ".2f"), Entry(str(failed), failed)]
        lines.append([*_place(standing), *entries])
    return Sheet(headings, lines)


def attacker_ranking(standings: Sequence[Standing]) -> Sheet:
    """Attackers by what the best defence of each scene leaves of the damage."""
    return Sheet(_ranked("attack", "best defence"), [_place(standing) for standing in standings])


def duels(scores: Scores, loss: Callable[[float], float], caption: str) -> Sheet:
    """A figure of every defender (lines) against every attack (columns), mean over scenes; shaded by what is lost."""
    attacks = list(dict.fromkeys(attack for by_attack in scores.values() for attack in by_attack))
    lines = []
    for defender, by_attack in scores.items():
        means = [float(np.mean(list(by_attack[a].values()))) if by_attack.get(a) else None for a in attacks]
        figures = [Entry("–") if m is None else Entry(f"{m:.2f}", m, loss(m)) for m in means]
        lines.append([Entry(defender), *figures])
    return Sheet([Heading("defender", number=False), *(Heading(attack) for attack in attacks)], lines, caption)


def curve_sheet(curve: Curve) -> Sheet:
    """Worst cases along an axis: damage a frame and AP@0.5 at every value of it."""
    headings = [Heading("defender", number=False)]
    for figure in ("damage", "AP@.5"):
        headings += [Heading(f"{figure}, {curve.symbol} = {value}") for value in curve.values]
    lines = [
        [Entry(name), *map(_interval, curve.damage[name]), *map(_interval, curve.ap50[name])] for name in curve.damage
    ]
    attacks = ", ".join(curve.attacks)
    return Sheet(headings, lines, f"Under the worst of {attacks} in each of {curve.n_scenes} scenes.")


def all_rows(tables: Mapping[tuple[str, float, int], Sequence[Row]]) -> Sheet:
    """Every row of every board; rows in which nobody lies once a fusion."""
    names = ("defender", "attack", "fusion")
    headings = [*(Heading(name, number=False) for name in names), Heading("Δ"), Heading("k"), Heading("scenes")]
    headings += [Heading(column[0]) for column in COLUMNS]
    lines: dict[tuple[object, ...], list[Entry]] = {}
    for (fusion, budget, _), rows in tables.items():
        for row in rows:
            delta = Entry("–") if row.attack == NOBODY else Entry(f"{budget:g}", budget)
            where = [Entry(row.defender), Entry(row.attack), Entry(fusion), delta, Entry(str(row.k), row.k)]
            figures = [_figure(row, name, spec) for _, name, spec, _ in COLUMNS]
            key = (row.defender, row.attack, fusion, delta.text, row.k)
            lines.setdefault(key, [*where, Entry(str(row.n_scenes), row.n_scenes), *figures])
    return Sheet(headings, list(lines.values()))


def _figure(row: Row, name: str, spec: str) -> Entry:
    value = getattr(row, name)
    number = value.mean if isinstance(value, Interval) else value
    return Entry(figure_text(row, name, spec, interval=True), None if number is None else float(number))


def _ranked(entry: str, opponent: str) -> list[Heading]:
    figures = [Heading(f"damage a frame, {opponent}"), Heading(f"AP@.5, {opponent}")]
    return [Heading("rank"), Heading(entry, number=False), *figures, Heading(f"{opponent} (scenes)", number=False)]


def _place(standing: Standing) -> list[Entry]:
    rank = Entry("–") if standing.rank is None else Entry(str(standing.rank), standing.rank)
    figures = [_interval(standing.damage), _interval(standing.ap50)]
    return [rank, Entry(standing.entry), *figures, Entry(_opponents(standing))]


def _interval(figure: Interval | None, spec: str = ".3f") -> Entry:
    return Entry("–") if figure is None else Entry(format(figure, spec), figure.mean)


def _opponents(standing: Standing) -> str:
    return ", ".join(f"{name} {count}" for name, count in standing.opponents)


def _plain(text: str) -> str:
    """Text that Markdown shows as it is."""
    return text.replace("&", "&amp;").replace("<", "&lt;").replace("|", "\\|").replace("*", "\\*").replace("_", "\\_")
