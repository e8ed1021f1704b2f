"""Tables of the report, as Markdown or as a part of a page: rankings, pairwise results, curves and all rows."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from cp_env.evaluation.analysis.comparisons import Difference
from cp_env.evaluation.analysis.curves import Curve
from cp_env.evaluation.analysis.measures import Measure, headlines, measure_of
from cp_env.evaluation.analysis.strata import Stratum
from cp_env.evaluation.analysis.summary import Row
from cp_env.evaluation.analysis.worst_case import Ranking, Scores
from cp_env.evaluation.plan.runs import NO_ATTACK
from cp_env.evaluation.report import driving
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


def defender_ranking(rankings: Sequence[Ranking], rows: Sequence[Row], screened: bool = False) -> Table:
    """Defenders by their worst case, with what they cost without an attack."""
    headings = [
        *_ranked(rankings, "defender", "screened attack" if screened else "worst attack", screened),
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
        lines.append([*_place(ranking, rankings, screened), *entries])
    return Table(headings, lines)


def further_ranking(rankings: Sequence[Ranking], screened: bool = False) -> Table:
    """Defenders by another measure than the first."""
    headings = _ranked(rankings, "defender", "screened attack" if screened else "worst attack", screened)
    return Table(headings, [_place(ranking, rankings, screened) for ranking in rankings])


def attack_ranking(rankings: Sequence[Ranking]) -> Table:
    """Attacks by what the best defence of each scene leaves."""
    return Table(_ranked(rankings, "attack", "best defence"), [_place(ranking, rankings) for ranking in rankings])


def difference_table(differences: Sequence[Difference], measure: Measure) -> Table:
    """Every pair of defenders over the same episodes, the one that keeps more first."""
    headings = [Heading("better", number=False), Heading("worse", number=False)]
    headings += [Heading(f"difference, {measure.heading}"), Heading("p, Holm"), Heading("told apart", number=False)]
    lines = []
    for pair in sorted(differences, key=lambda pair: pair.adjusted):
        turned = (pair.interval.mean > 0) is measure.lower_is_better
        names = (pair.second, pair.first) if turned else (pair.first, pair.second)
        sign = -1 if turned else 1
        low, high = sorted((sign * pair.interval.low, sign * pair.interval.high))
        interval = Interval(sign * pair.interval.mean, low, high, pair.interval.n)
        p = "< 0.001" if pair.adjusted < 0.001 else f"{pair.adjusted:.3f}"
        told = Entry("yes" if pair.told_apart else "no")
        lines.append([*map(Entry, names), _interval(interval), Entry(p, pair.adjusted), told])
    return Table(headings, lines)


def strata_table(strata: Sequence[Stratum], names: Sequence[str] = ("ap50", "damage")) -> Table:
    """Where the ego is benign beside where it is an attacker: episodes and some columns of `COLUMNS`."""
    columns = [column for column in COLUMNS if column[1] in names]
    headings = [Heading("defender", number=False), Heading("attack", number=False)]
    lines: dict[tuple[str, str], list[list[Entry]]] = {}
    for stratum in strata:
        said = stratum.title.rpartition(" ego is ")[2]
        headings += [Heading(f"episodes, ego {said}"), *(Heading(f"{column[0]}, ego {said}") for column in columns)]
        for row in stratum.rows:
            values = [_metric(row, name, spec) for _, name, spec, _ in columns]
            lines.setdefault((row.defender, row.attack), []).append(
                [Entry(str(row.n_episodes), row.n_episodes), *values]
            )
    whole = {key: parts for key, parts in lines.items() if len(parts) == len(strata)}
    return Table(headings, [[*map(Entry, key), *(e for part in parts for e in part)] for key, parts in whole.items()])


def driving_table(rows: Sequence[Row]) -> Table:
    """What the driver feels, row by row; without those whose driving was not recorded."""
    headings = [Heading("defender", number=False), Heading("attack", number=False), Heading("k")]
    headings += [Heading(heading) for heading, *_ in driving.COLUMNS]
    lines = [
        [
            *(Entry(row.defender), Entry(row.attack), Entry(str(row.k), row.k)),
            *(Entry(text, value) for text, value in driving.driving_cells(row.driving)),
        ]
        for row in rows
        if row.driving is not None
    ]
    return Table(headings, lines)


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
    return Table(headings, lines, f"{curve.under[0].upper()}{curve.under[1:]}; {curve.n_scenes} scenes.")


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
    value = row.value(name)
    number = value.mean if isinstance(value, Interval) else value
    return Entry(metric_text(row, name, spec, interval=True), None if number is None else float(number))


def _ranked(rankings: Sequence[Ranking], entry: str, opponent: str, screened: bool = False) -> list[Heading]:
    values = [Heading(f"{measure.heading}, {opponent}") for measure in _columns(rankings)]
    named = Heading(opponent if screened else f"{opponent} (scenes)", number=False)
    return [Heading("rank"), Heading("first"), Heading(entry, number=False), *values, named]


def _place(ranking: Ranking, rankings: Sequence[Ranking], screened: bool = False) -> list[Entry]:
    place = ranking.place
    rank = Entry("–") if place is None else Entry(str(place), place.rank)
    first = Entry("–") if place is None or place.first is None else Entry(_probability(place.first), place.first)
    values = [_interval(ranking.values.get(of.name), of.spec) for of in _columns(rankings)]
    opponents = ", ".join(name if screened else f"{name} {count}" for name, count in ranking.opponents)
    return [rank, first, Entry(ranking.entry), *values, Entry(opponents)]


def _columns(rankings: Sequence[Ranking]) -> list[Measure]:
    """The measures of a ranking that have values: that which ranks, then the others."""
    shown = dict.fromkeys([*(ranking.by for ranking in rankings[:1]), *headlines()])
    known = {name for ranking in rankings for name in ranking.values}
    return [measure_of(name) for name in shown if name in known]


def _probability(value: float) -> str:
    return "< 0.01" if 0 < value < 0.01 else "> 0.99" if 0.99 < value < 1 else f"{value:.2f}"


def _interval(metric: Interval | None, spec: str = ".3f") -> Entry:
    return Entry("–") if metric is None else Entry(format(metric, spec), metric.mean)


def _plain(text: str) -> str:
    """Text that Markdown shows unchanged."""
    return text.replace("&", "&amp;").replace("<", "&lt;").replace("|", "\\|").replace("*", "\\*").replace("_", "\\_")
