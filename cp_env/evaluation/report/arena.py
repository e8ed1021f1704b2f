"""An arena run's report: one page of HTML that needs no network, and the same in Markdown."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cp_env.evaluation.analysis.measures import MEASURES, measure_of
from cp_env.evaluation.analysis.results import ArenaResults
from cp_env.evaluation.plan.files import write_atomically
from cp_env.evaluation.report import html
from cp_env.evaluation.report.benchmark import ENDED, GLOSSARY, INTERVALS, ended_markdown
from cp_env.evaluation.report.driving import DRIVING
from cp_env.evaluation.report.tables import (
    Table,
    all_rows,
    attack_ranking,
    curve_table,
    defender_ranking,
    difference_table,
    driving_table,
    further_ranking,
    pairwise_results,
    strata_table,
)
from cp_env.rendering import style

LOOKED_UP = """\
In each scene a defender meets the attack that is worst for it there by the measure of the column. The attack is \
picked on the scenes that are reported on, so scores are biased towards the worse."""
SCREENED = """\
Each defender meets the attack that was worst for it on {scenes}, which is not reported on."""
RANKED = """\
Detection loss: 1 − Jaccard of the ego's boxes and those of the unattacked output, a mean over the frames under \
attack. A score is the mean over scenes, with Gaffke's 95 % interval, which stays in [0, 1]. Rank: by the first \
column; "2–3" where paired comparisons over the same episodes, with Holm's correction, do not tell an entry from those \
beside it. First: the share of resampled sets of scenes in which the entry is first. A defender that is given the \
attackers bounds what can be reached and has no rank."""
LEFT_OVER = """\
The reverse: what an attack does to the defence that is best against it in each scene (none that is given the \
attackers), in each column by its own measure."""
COMPARED = """\
Every pair of ranked defenders over the same episodes, each under its worst attack as above: mean difference with \
Student's 95 % interval of the pair by itself; p of the paired test after Holm's correction over all pairs of the \
table. Fewer than six scenes tell nobody apart."""
APART = """\
Episodes in which the ego is benign, and those in which it is an attacker itself: it never leaves out its own map."""
VIDEO_CAPTION = """\
What the ego of each defender perceives in its worst episode, every other frame; the loop begins with the frame that \
tells most. Green: a true vehicle that was found, with the blue box that is perceived there; yellow, filled: missed; \
purple, crossed out: a ghost. White discs are fused, empty ones are not; orange rings are attackers, crosses suspects. \
Below, the similarity to the previous output, with the alarm threshold where there is one."""


def lead(results: ArenaResults) -> str:
    """The baseline in a sentence."""
    conditions, k = results.baseline.conditions, results.baseline.k
    described = conditions.describe()
    seeds = len({run.seed for run in results.baseline.runs})
    return (
        f"{results.n_scenes} scenes of {described['scenes']}, {conditions.frames} frames of each, "
        f"{seeds} seed{'s' if seeds > 1 else ''}; {k} of {conditions.n_vehicles} vehicles malicious, by seed, "
        f"Δ = {conditions.budget:g} ({conditions.norm}), {conditions.fusion} fusion, {conditions.grace_frames} "
        f"frame{'' if conditions.grace_frames == 1 else 's'} of grace, {conditions.ap} AP."
    )


def ranking_words(results: ArenaResults) -> str:
    """What the ranking of defenders says, and how each one's attack was picked."""
    if results.screening is None:
        return f"{LOOKED_UP} {RANKED}"
    described = results.screening.conditions.describe()
    n = len(described["names"])
    scenes = f"{n} scene{'' if n == 1 else 's'} of {described['scenes']}"
    return f"{SCREENED.format(scenes=scenes)} {RANKED}"


def draw_plots(results: ArenaResults) -> dict[str, str]:
    """SVG by name: "defenders", "attacks", "trade-off" and one for each curve."""
    from cp_env.evaluation.report import plots  # matplotlib is slow to import, and workers never draw

    rows = results.rows_at[results.baseline.point]
    colours = style.defender_colours(list(dict.fromkeys(row.defender for row in rows)))
    worst = "worst attack of each scene" if results.screening is None else "screened attack"
    drawn = {}
    if results.defenders:
        drawn["defenders"] = plots.bars(results.defenders, colours, worst)
        drawn["attacks"] = plots.bars(results.attacks, None, "best defence of each scene")
    if rows:
        drawn["trade-off"] = plots.trade_off(rows, colours)
    return drawn | {f"curve-{curve.axis}": plots.lines(curve, colours) for curve in results.curves}


def make_tables(results: ArenaResults) -> dict[str, Table]:
    """Tables by name, in the order in which they are shown."""
    rows = results.rows_at[results.baseline.point]
    screened = results.screening is not None
    made = {"defenders": defender_ranking(results.defenders, rows, screened)}
    made |= {f"by-{name}": further_ranking(of, screened) for name, of in results.further.items() if of}
    if results.differences:
        made["differences"] = difference_table(results.differences, measure_of(results.by))
    made["attacks"] = attack_ranking(results.attacks)
    for name, scores in results.scores.items():
        if any(by_scene for by_attack in scores.values() for by_scene in by_attack.values()):
            made[name] = pairwise_results(scores, MEASURES[name].loss, MEASURES[name].caption)
    if results.strata:
        made["strata"] = strata_table(results.strata)
    if any(row.driving is not None for row in rows):
        made["driving"] = driving_table(rows)
    return made | {f"curve-{curve.axis}": curve_table(curve) for curve in results.curves}


def headings_of(results: ArenaResults) -> dict[str, str]:
    """The headings by the table that stands first below each."""
    found = {"defenders": "Defenders"}
    found |= {f"by-{name}": f"Defenders by {measure_of(name).heading}" for name in results.further}
    found |= {"differences": "Pairs of defenders", "attacks": "Attacks", next(iter(results.scores)): "Pairwise results"}
    return (
        found
        | {"strata": "By the ego", "driving": "Driving"}
        | {f"curve-{c.axis}": f"Over {c.symbol}" for c in results.curves}
    )


def words_of(results: ArenaResults) -> dict[str, str]:
    """What stands above some tables."""
    return {"defenders": ranking_words(results), "differences": COMPARED, "attacks": LEFT_OVER, "strata": APART}


def write_html(results: ArenaResults, drawn: Mapping[str, str], folder: Path, about: dict[str, Any]) -> Path:
    """Write `arena.html`: everything in one file, with the plots that were drawn of it."""
    headings, words = headings_of(results), words_of(results)
    alts = {"defenders": "Defenders, worst case", "attacks": "Attacks, best defence"}
    below = {"ap50": ("trade-off", "AP over detection loss and over verifications")}
    parts: list[tuple[str, list[str]]] = []
    for name, table in make_tables(results).items():
        if name in headings:
            parts.append((headings[name], []))
        shown = parts[-1][1]
        shown += [html.paragraph(words[name])] if name in words else []
        shown.append(html.table(table))
        plot, alt = below.get(name, (name, alts.get(name, f"Worst cases: {headings.get(name, name)}")))
        shown += [html.plot(drawn[plot], alt)] if plot in drawn else []
    if results.worst:
        parts.append(("Worst episodes", [html.paragraph(VIDEO_CAPTION), html.videos(_videos(results))]))
    parts.append(
        (
            "All results",
            [html.table(all_rows(results.rows_at)), html.preformatted("\n".join([INTERVALS, GLOSSARY, DRIVING]))],
        )
    )
    parts.append(("How it was made", [html.preformatted(about["command"]), html.facts(_facts(about))]))
    if results.flags:
        parts.insert(0, ("To be looked at", [html.paragraph(flag, "warning") for flag in results.flags]))
    if results.ended:
        parts.insert(0, ("Failed episodes", [html.paragraph("\n".join([ENDED, *results.ended]), "warning")]))
    if results.failed:
        parts.insert(0, ("Not played", [html.paragraph(results.failed, "warning")]))
    path = folder / "arena.html"
    write_atomically(path, html.page("Arena", lead(results), parts))
    return path


def write_markdown(
    results: ArenaResults,
    path: Path,
    about: dict[str, Any],
    links: Mapping[str, str] | None = None,
    title: str = "Arena",
) -> Path:
    """Write the report in Markdown; `links` are plots to show with the table of their name."""
    tables, headings, words = make_tables(results), headings_of(results), words_of(results)
    parts = [f"# {title}\n", lead(results) + "\n"]
    parts += [f"**Not played.**\n\n```\n{results.failed}\n```\n"] if results.failed else []
    parts += [ended_markdown(results.ended)] if results.ended else []
    flags = "\n".join(f"* {flag}" for flag in results.flags)
    parts += [f"**To be looked at.**\n\n{flags}\n"] if flags else []
    links = dict(links or {})
    for name, table in tables.items():
        heading = headings.get(name)
        parts += [f"## {heading}\n"] if heading else []
        parts += [words[name] + "\n"] if name in words else []
        parts.append(table.markdown())
        parts += [f"![{heading or name}]({links.pop(name)})\n"] if name in links else []
    parts += [f"![{name}]({link})\n" for name, link in links.items()]
    parts += ["## All results\n", all_rows(results.rows_at).markdown(), INTERVALS, GLOSSARY, DRIVING]
    facts = [f"* {name}: {what}" for name, what in _facts(about)]
    parts += ["## How it was made\n", f"```sh\n{about['command']}\n```\n", "\n".join(facts) + "\n"]
    write_atomically(path, "\n".join(parts))
    return path


def _videos(results: ArenaResults) -> list[str]:
    made = []
    for name, one in results.worst.items():
        run = one.run
        caption = f"{name} against {run.attack}: {run.names[0]}, seed {run.seed}, detection loss/frame {one.damage:.2f}"
        made.append(html.picture(one.gif.read_bytes(), "gif", caption, caption))
    return made


def _facts(about: dict[str, Any]) -> list[tuple[str, str]]:
    """Conditions, versions and the machine, as text."""
    flat = {
        **{key: value for key, value in about.items() if key not in ("command", "conditions")},
        **about["conditions"],
    }
    return [(name, value if isinstance(value, str) else _words(value)) for name, value in flat.items()]


def _words(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{key} {inner}" for key, inner in value.items())
    return ", ".join(map(str, value)) if isinstance(value, list | tuple) else json.dumps(value)
