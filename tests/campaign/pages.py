"""Reports with hostile names, opened in a real browser: shown as text, nothing runs, nothing is asked for, all fits."""

from __future__ import annotations

import html
from dataclasses import replace
from pathlib import Path

from cp_env.evaluation import Store, about
from cp_env.evaluation.analysis.results import collect_results
from cp_env.evaluation.plan.grid import Axes
from cp_env.evaluation.report.arena import write_html, write_markdown
from tests.campaign.case import Case, Fault, Figures
from tests.helpers.browser import CHROMIUM, DRIVER, Browser, browser
from tests.helpers.toy_evaluation import CONDITIONS, record

PART = "pages"
WIDTHS = (420, 1280)
NAMES: dict[str, str] = {
    "a script": "<script>hacked=1</script>",
    "an image": "<img src=x onerror=hacked=1>",
    "the end of a script": "</script><script>hacked=1//",
    "the end of a style": "</style><script>hacked=1</script>",
    "the end of a table": "</td></tr></table><svg onload=hacked=1>",
    "quotes": '"\'`" onmouseover="hacked=1" x=\'',
    "entities": "&lt;script&gt; &amp;quot; &#60;b&#62; &nbsp",
    "a comment": "<!-- --><!--",
    "a template": "{{7*7}} ${7*7} #{7*7} %s {0}",
    "Markdown": "[a](javascript:hacked=1) ![b](x) `|` **|** |---|",
    "an address": "javascript:hacked=1",
    "right to left": "‮gnihton sevig siht‬ שלום مرحبا",
    "marks": "Z̷̡̢̛̲̹̖̈́̈̎a̴͔̿l̵̹̈́g̸̙̈o̴̠͝",
    "nothing seen": "\u200b\u200d\ufeff\u2060",
    "formulas": "$x_1$ \\frac{1}{2} $$",
    "very long": "x" * 400,
    "very long words": " ".join(["unbreakable" * 12] * 3),
    "lines": "first\nsecond\r\nthird\ttab",
    "emoji": "👩‍👩‍👧‍👦🏳️‍🌈",
    "signs": "../../etc/passwd C:\\x ?a=b#c %00 %2e",
}
"""What the options of plug-ins may say, and a report has to show. No comma: it would end a value."""


def specs() -> list[str]:
    """Plug-ins as they are named, with each of these as the value of an option."""
    return [f"p:name={value}" for value in NAMES.values()]


def cases() -> list[Case]:
    return [Case(PART, f"a report with {len(NAMES)} hostile names", play)]


def play(folder: Path) -> Figures:
    """Write a report of invented results with all names, and open it."""
    if not (CHROMIUM and DRIVER):
        raise Fault("there is no chromium with its driver: apt-get install chromium chromium-driver")
    page = write(folder / "report", specs())
    with browser(folder / "profile") as window:
        window.open(page)
        return check(window, page, specs())


def write(folder: Path, names: list[str]) -> Path:
    """A report whose defenders and attacks have these names."""
    axes = Axes(defenders=("none", *names), attacks=("none", names[0], names[-1]), ks=(1,))
    grids = axes.grids(replace(CONDITIONS, names=CONDITIONS.names[:1]), {"mean": Store(folder)})
    for grid in grids:
        for number, run in enumerate(grid.runs):
            harm = 0.0 if run.attack == "none" else number * 37 % 100 / 100
            frames = {"attackers": (1, 3, 4)[: run.k], "damage": (0.0, harm, harm)}
            grid.store.write(run, grid.conditions, [record(scene, "110", 3, **frames) for scene in run.names])
    results = replace(collect_results(grids, folder, resamples=5, failed=" ".join(names)), worst={})  # no videos
    provenance = about(CONDITIONS, f"cp-arena --defenders {' '.join(names)}", seeds=[0], workers=1, threads=1)
    write_markdown(results, folder / "arena.md", provenance)
    return write_html(results, {}, folder, provenance)


def check(window: Browser, page: Path, names: list[str]) -> Figures:
    """Fault unless the page shows every name as it is, runs nothing, asks for nothing and fits its window."""
    if window.run("return typeof hacked") != "undefined":
        raise Fault("a name was run")
    if complaints := window.log("browser"):
        raise Fault(f"the browser complains: {complaints[0]['message'][:300]}")
    asked = [url for url in window.requests() if not url.startswith(("data:", "chrome:"))]
    if asked != [page.resolve().as_uri()]:
        raise Fault(f"it asked for {asked[:3]}")
    cells = set(window.run("return [...document.querySelectorAll('td')].map(d => d.textContent)"))
    wanted = {name: " ".join(html.unescape(html.escape(name)).split("\r\n")) for name in names}
    seen = {" ".join(cell.split()) for cell in cells}
    if missing := [name for name, told in wanted.items() if " ".join(told.split()) not in seen]:
        raise Fault(f"not shown as they are: {[name[:60] for name in missing]}")
    tables = window.run("return document.querySelectorAll('table').length")
    for width in WIDTHS:
        window.resize(width, 900)
        if not window.run("return document.documentElement.scrollWidth <= innerWidth"):
            raise Fault(f"it is wider than a window of {width} pixels")
    return {"names": len(names), "tables": tables, "widths": "/".join(map(str, WIDTHS))}
