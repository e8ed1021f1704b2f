"""An arena run's report: one page of HTML that needs no network, and the same in Markdown."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cp_env.evaluation.analysis.results import Findings
from cp_env.evaluation.plan.records import write_atomically
from cp_env.evaluation.report import html, plots
from cp_env.evaluation.report.benchmark import GLOSSARY, INTERVALS
from cp_env.evaluation.report.tables import Sheet, all_rows, attacker_ranking, curve_sheet, defender_ranking, duels

RANKED = """\
In each scene a defender meets the attack that does it the most damage there (1 − Jaccard of the ego's boxes and \
those it would have seen unattacked, a mean over frames); its standing is the mean over scenes, with Student's 95 % \
interval. AP@.5 is under the attack that leaves the least of it. A defender that is told who lies bounds what can be \
reached and has no rank."""
LEFT_OVER = """\
The other way round: how much damage an attack does to the defence that is best against it in each scene (none that is \
told who lies), and the most AP@.5 any of them keeps."""
FILMED = """\
The ego of each defender in the episode in which it lost the most, every other frame. Green: a true vehicle that was \
found, under the ego's blue box; yellow: missed; magenta: a ghost. White discs are fused; red rings lie, orange \
crosses are suspected. Below, the similarity to the previous output, with the alarm threshold where there is one."""


def lead(found: Findings) -> str:
    """The base point in a sentence."""
    protocol, k = found.base.protocol, found.base.k
    conditions = protocol.describe()
    seeds = len({cell.seed for cell in found.base.cells})
    return (
        f"{found.n_scenes} scenes of {conditions['scenes']}, {protocol.frames} frames of each, "
        f"{seeds} seed{'s' if seeds > 1 else ''}; {k} of {protocol.n_vehicles} vehicles lie, drawn by the seed, "
        f"Δ = {protocol.budget:g} ({protocol.norm}), {protocol.fusion} fusion, {protocol.grace_frames} "
        f"frame{'' if protocol.grace_frames == 1 else 's'} of grace, {protocol.ap} AP."
    )


def pictures(found: Findings) -> dict[str, str]:
    """SVG by name: "defenders", "attackers", "trade-off" and one for each curve."""
    rows = found.tables[found.base.point]
    colours = plots.colours_of(list(dict.fromkeys(row.defender for row in rows)))
    drawn = {}
    if found.defenders:
        drawn["defenders"] = plots.bars(found.defenders, colours, "worst attack of each scene")
        drawn["attackers"] = plots.bars(found.attackers, None, "best defence of each scene")
    if rows:
        drawn["trade-off"] = plots.trade_off(rows, colours)
    return drawn | {f"curve-{curve.axis}": plots.lines(curve, colours) for curve in found.curves}


def sheets(found: Findings) -> dict[str, Sheet]:
    """Tables by name, in the order in which they are shown."""
    rows = found.tables[found.base.point]
    made = {
        "defenders": defender_ranking(found.defenders, rows),
        "attackers": attacker_ranking(found.attackers),
        "damage": duels(found.damage, lambda damage: damage, "Damage a frame, mean over scenes."),
        "ap50": duels(found.ap50, lambda ap: 1 - ap, "AP@0.5 of a scene, mean over scenes."),
    }
    return made | {f"curve-{curve.axis}": curve_sheet(curve) for curve in found.curves}


def write_html(found: Findings, drawn: Mapping[str, str], folder: Path, about: dict[str, Any]) -> Path:
    """`arena.html`: everything in one file, with the `pictures` that were drawn of it."""
    tables = {name: html.table(sheet) for name, sheet in sheets(found).items()}

    def shown(name: str, alt: str) -> str:
        return html.plot(drawn[name], alt) if name in drawn else ""

    parts: list[tuple[str, list[str]]] = [
        ("Defenders", [html.paragraph(RANKED), tables["defenders"], shown("defenders", "Defenders, worst case")]),
        ("Attackers", [html.paragraph(LEFT_OVER), tables["attackers"], shown("attackers", "Attackers, best defence")]),
        ("Duels", [tables["damage"], tables["ap50"], shown("trade-off", "AP over damage and over verifications")]),
    ]
    for curve in found.curves:
        name = f"curve-{curve.axis}"
        parts.append((f"Along {curve.symbol}", [tables[name], shown(name, f"Worst cases along {curve.symbol}")]))
    if found.worst:
        parts.append(("Worst episodes", [html.paragraph(FILMED), html.films(_films(found))]))
    parts.append(("All figures", [html.table(all_rows(found.tables)), html.preformatted(INTERVALS + "\n" + GLOSSARY)]))
    parts.append(("How it was made", [html.preformatted(about["command"]), html.facts(_facts(about))]))
    if found.failed:
        parts.insert(0, ("Not played", [html.paragraph(found.failed, "warning")]))
    path = folder / "arena.html"
    write_atomically(path, html.page("Arena", lead(found), parts))
    return path


def write_markdown(
    found: Findings, path: Path, about: dict[str, Any], links: Mapping[str, str] | None = None, title: str = "Arena"
) -> Path:
    """The report in Markdown; `links` are pictures to show with the table of their name."""
    tables = sheets(found)
    headings = {"defenders": "Defenders", "attackers": "Attackers", "damage": "Duels"}
    headings |= {f"curve-{curve.axis}": f"Along {curve.symbol}" for curve in found.curves}
    words = {"defenders": RANKED, "attackers": LEFT_OVER}
    parts = [f"# {title}\n", lead(found) + "\n"]
    parts += [f"**Not played.**\n\n```\n{found.failed}\n```\n"] if found.failed else []
    links = dict(links or {})
    for name, sheet in tables.items():
        heading = headings.get(name)
        parts += [f"## {heading}\n"] if heading else []
        parts += [words[name] + "\n"] if name in words else []
        parts.append(sheet.markdown())
        parts += [f"![{heading or name}]({links.pop(name)})\n"] if name in links else []
    parts += [f"![{name}]({link})\n" for name, link in links.items()]
    parts += ["## All figures\n", all_rows(found.tables).markdown(), INTERVALS, GLOSSARY]
    facts = [f"* {name}: {what}" for name, what in _facts(about)]
    parts += ["## How it was made\n", f"```sh\n{about['command']}\n```\n", "\n".join(facts) + "\n"]
    write_atomically(path, "\n".join(parts))
    return path


def _films(found: Findings) -> list[str]:
    made = []
    for name, one in found.worst.items():
        cell = one.cell
        told = f"{name} against {cell.attack}: {cell.names[0]}, seed {cell.seed}, damage {one.damage:.2f} a frame"
        made.append(html.picture(one.gif.read_bytes(), "gif", told, told))
    return made


def _facts(about: dict[str, Any]) -> list[tuple[str, str]]:
    """Conditions, versions and the machine, in words."""
    flat = {**{key: value for key, value in about.items() if key not in ("command", "protocol")}, **about["protocol"]}
    return [(name, value if isinstance(value, str) else _words(value)) for name, value in flat.items()]


def _words(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{key} {inner}" for key, inner in value.items())
    return ", ".join(map(str, value)) if isinstance(value, list | tuple) else json.dumps(value)
