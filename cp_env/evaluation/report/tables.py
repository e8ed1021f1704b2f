"""Tables of the report, as Markdown or as a part of a page: rankings, pairwise results, curves and all rows."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from cp_env.evaluation.analysis.curves import Curve
from cp_env.evaluation.analysis.summary import Row
from cp_env.evaluation.analysis.worst_case import Ranking, Scores
from cp_env.evaluation.plan.runs import NO_ATTACK
from cp_env.evaluation.report.benchmark import COLUMNS, metric_text
from cp_env.metrics.intervals import Interval


@dataclass(frozen=True)
class Entry:
    """One entry of a table: its text, the value it is sorted by, and how strongly it is shaded (0 to 1)."""

    text: str
    value: float | None = None
    shade: float | None = None


@dataclass(frozen=True)
class Heading:
    """One column. Those of numbers are set flush right and sorted as numbers."""

    text: str
    number: bool = True


@dataclass(frozen=True)
class Table:
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


def defender_ranking(rankings: Sequence[Ranking], rows: Sequence[Row]) -> Table:
    """Defenders by their worst case, with what they cost without an attack."""
    headings = [
        *_ranked("defender", "worst attack"),
        Heading("AP@.5, no attack"),
        Heading("verifications/frame, costliest attack"),
        Heading("failed"),
    ]
    lines = []
    for ranking in rankings:
        mine = [row for row in rows if row.defender == ranking.entry]
        clean = next((row.ap50 for row in mine if row.attack == NO_ATTACK), None)
        costliest = max((row.verifications for row in mine), key=lambda cost: cost.mean, default=None)
        failed = sum(row.n_errors for row in mine)
        entries = [_interval(clean), _interval(costliest, ".2f"), Entry(str(failed), failed)]
        lines.append([*_place(ranking), *entries])
    return Table(headings, lines)


def attack_ranking(rankings: Sequence[Ranking]) -> Table:
    """Attacks by the damage that the best defence of each scene leaves."""
    return Table(_ranked("attack", "best defence"), [_place(ranking) for ranking in rankings])


def pairwise_results(scores: Scores, loss: Callable[[float], float], caption: str) -> Table:
    """A metric of every defender (lines) against every attack (columns), mean over scenes; shaded by what is lost."""
    attacks = list(dict.fromkeys(attack for by_attack in scores.values() for attack in by_attack))
    lines = []
    for defender, by_attack in scores.items():
        means = [float(np.mean(list(by_attack[a].values()))) if by_attack.get(a) else None for a in attacks]
        values = [Entry("–") if m is None else Entry(f"{m:.2f}", m, loss(m)) for m in means]
        lines.append([Entry(defender), *values])
    return Table([Heading("defender", number=False), *(Heading(attack) for attack in attacks)], lines, caption)


def curve_table(curve: Curve) -> Table:
    """Worst cases over an axis: damage per frame and AP@0.5 at every value of it."""
    headings = [Heading("defender", number=False)]
    for metric in ("detection loss/frame", "AP@.5"):
        headings += [Heading(f"{metric}, {curve.symbol} = {value}") for value in curve.values]
    lines = [
        [Entry(name), *map(_interval, curve.damage[name]), *map(_interval, curve.ap50[name])] for name in curve.damage
    ]
    attacks = ", ".join(curve.attacks)
    return Table(headings, lines, f"Under the worst of {attacks} in each of {curve.n_scenes} scenes.")


def all_rows(rows_at: Mapping[tuple[str, float, int], Sequence[Row]]) -> Table:
    """Every row of every grid; rows without an attack once a fusion."""
    names = ("defender", "attack", "fusion")
    headings = [*(Heading(name, number=False) for name in names), Heading("Δ"), Heading("k"), Heading("scenes")]
    headings += [Heading(column[0]) for column in COLUMNS]
    lines: dict[tuple[object, ...], list[Entry]] = {}
    for (fusion, budget, _), rows in rows_at.items():
        for row in rows:
            delta = Entry("–") if row.attack == NO_ATTACK else Entry(f"{budget:g}", budget)
            where = [Entry(row.defender), Entry(row.attack), Entry(fusion), delta, Entry(str(row.k), row.k)]
            values = [_metric(row, name, spec) for _, name, spec, _ in COLUMNS]
            key = (row.defender, row.attack, fusion, delta.text, row.k)
            lines.setdefault(key, [*where, Entry(str(row.n_scenes), row.n_scenes), *values])
    return Table(headings, list(lines.values()))


def _metric(row: Row, name: str, spec: str) -> Entry:
    value = getattr(row, name)
    number = value.mean if isinstance(value, Interval) else value
    return Entry(metric_text(row, name, spec, interval=True), None if number is None else float(number))


def _ranked(entry: str, opponent: str) -> list[Heading]:
    values = [Heading(f"detection loss/frame, {opponent}"), Heading(f"AP@.5, {opponent}")]
    return [Heading("rank"), Heading(entry, number=False), *values, Heading(f"{opponent} (scenes)", number=False)]


def _place(ranking: Ranking) -> list[Entry]:
    rank = Entry("–") if ranking.rank is None else Entry(str(ranking.rank), ranking.rank)
    values = [_interval(ranking.damage), _interval(ranking.ap50)]
    return [rank, Entry(ranking.entry), *values, Entry(_opponents(ranking))]


def _interval(metric: Interval | None, spec: str = ".3f") -> Entry:
    return Entry("–") if metric is None else Entry(format(metric, spec), metric.mean)


def _opponents(ranking: Ranking) -> str:
    return ", ".join(f"{name} {count}" for name, count in ranking.opponents)


def _plain(text: str) -> str:
    """Text that Markdown shows unchanged."""
    return text.replace("&", "&amp;").replace("<", "&lt;").replace("|", "\\|").replace("*", "\\*").replace("_", "\\_")
