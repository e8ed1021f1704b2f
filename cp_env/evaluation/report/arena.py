"""An arena run's report: one page of HTML that needs no network, and the same in Markdown."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cp_env.evaluation.analysis.results import ArenaResults
from cp_env.evaluation.plan.files import write_atomically
from cp_env.evaluation.report import html, plots
from cp_env.evaluation.report.benchmark import GLOSSARY, INTERVALS
from cp_env.evaluation.report.tables import (
    Table,
    all_rows,
    attack_ranking,
    curve_table,
    defender_ranking,
    pairwise_results,
)

RANKED = """\
In each scene a defender meets the attack that does it the most damage there (detection loss: 1 − Jaccard of the \
ego's boxes and those of the unattacked output, a mean over the frames under attack). Its score is the mean over \
scenes, with Student's 95 % interval. AP@.5 is under the attack that leaves the least of it. A defender that is given \
the attackers bounds what can be reached and has no rank."""
LEFT_OVER = """\
The reverse: the damage of an attack to the defence that is best against it in each scene (none that is given the \
attackers), and the most AP@.5 that any of them keeps."""
VIDEO_CAPTION = """\
The ego of each defender in its worst episode, every other frame. Green: a true vehicle that was found, under the \
ego's blue box; yellow: missed; magenta: a ghost. White discs are fused; red rings are attackers, orange crosses are \
flagged. Below, the similarity to the previous output, with the alarm threshold where there is one."""


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


def draw_plots(results: ArenaResults) -> dict[str, str]:
    """SVG by name: "defenders", "attacks", "trade-off" and one for each curve."""
    rows = results.rows_at[results.baseline.point]
    colours = plots.colours_of(list(dict.fromkeys(row.defender for row in rows)))
    drawn = {}
    if results.defenders:
        drawn["defenders"] = plots.bars(results.defenders, colours, "worst attack of each scene")
        drawn["attacks"] = plots.bars(results.attacks, None, "best defence of each scene")
    if rows:
        drawn["trade-off"] = plots.trade_off(rows, colours)
    return drawn | {f"curve-{curve.axis}": plots.lines(curve, colours) for curve in results.curves}


def make_tables(results: ArenaResults) -> dict[str, Table]:
    """Tables by name, in the order in which they are shown."""
    rows = results.rows_at[results.baseline.point]
    made = {
        "defenders": defender_ranking(results.defenders, rows),
        "attacks": attack_ranking(results.attacks),
        "damage": pairwise_results(results.damage, lambda damage: damage, "Detection loss/frame, mean over scenes."),
        "ap50": pairwise_results(results.ap50, lambda ap: 1 - ap, "AP@0.5 of a scene, mean over scenes."),
    }
    return made | {f"curve-{curve.axis}": curve_table(curve) for curve in results.curves}


def write_html(results: ArenaResults, drawn: Mapping[str, str], folder: Path, about: dict[str, Any]) -> Path:
    """Write `arena.html`: everything in one file, with the plots that were drawn of it."""
    tables = {name: html.table(table) for name, table in make_tables(results).items()}

    def shown(name: str, alt: str) -> str:
        return html.plot(drawn[name], alt) if name in drawn else ""

    parts: list[tuple[str, list[str]]] = [
        ("Defenders", [html.paragraph(RANKED), tables["defenders"], shown("defenders", "Defenders, worst case")]),
        ("Attacks", [html.paragraph(LEFT_OVER), tables["attacks"], shown("attacks", "Attacks, best defence")]),
        (
            "Pairwise results",
            [tables["damage"], tables["ap50"], shown("trade-off", "AP over detection loss and over verifications")],
        ),
    ]
    for curve in results.curves:
        name = f"curve-{curve.axis}"
        parts.append((f"Over {curve.symbol}", [tables[name], shown(name, f"Worst cases over {curve.symbol}")]))
    if results.worst:
        parts.append(("Worst episodes", [html.paragraph(VIDEO_CAPTION), html.videos(_videos(results))]))
    parts.append(
        ("All results", [html.table(all_rows(results.rows_at)), html.preformatted(INTERVALS + "\n" + GLOSSARY)])
    )
    parts.append(("How it was made", [html.preformatted(about["command"]), html.facts(_facts(about))]))
    if results.flags:
        parts.insert(0, ("To be looked at", [html.paragraph(flag, "warning") for flag in results.flags]))
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
    tables = make_tables(results)
    headings = {"defenders": "Defenders", "attacks": "Attacks", "damage": "Pairwise results"}
    headings |= {f"curve-{curve.axis}": f"Over {curve.symbol}" for curve in results.curves}
    words = {"defenders": RANKED, "attacks": LEFT_OVER}
    parts = [f"# {title}\n", lead(results) + "\n"]
    parts += [f"**Not played.**\n\n```\n{results.failed}\n```\n"] if results.failed else []
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
    parts += ["## All results\n", all_rows(results.rows_at).markdown(), INTERVALS, GLOSSARY]
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
