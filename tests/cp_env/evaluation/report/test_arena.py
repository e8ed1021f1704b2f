"""The page: one file that fetches nothing, shows names as they are, and sorts its tables in a real browser."""

from __future__ import annotations

import base64
import io
import json
import re
from collections.abc import Iterator
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from cp_env.evaluation import Store, about
from cp_env.evaluation.analysis.results import collect_results, write_json
from cp_env.evaluation.analysis.worst_episodes import Worst
from cp_env.evaluation.plan.grid import Axes
from cp_env.evaluation.report.arena import draw_plots, write_html, write_markdown
from cp_env.evaluation.report.leaderboard import write_leaderboard
from cp_env.rendering.gif import write_gif
from tests.helpers.browser import CHROMIUM, DRIVER, Browser, browser
from tests.helpers.toy_evaluation import CONDITIONS, record

HOSTILE = '<script>hacked = 1</script><img src=x onerror="hacked = 1">"&\'|$x_1$'
DEFENDERS = ("none", "wall", HOSTILE, "seer")
ATTACKS = ("loud", "sly", f"q:name={HOSTILE}")


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A report of invented results, with names that cannot be trusted."""
    folder = tmp_path_factory.mktemp("page")
    axes = Axes(defenders=DEFENDERS, attacks=ATTACKS, ks=(2, 1, 3), budgets=(0.3, 0.1))
    grids = axes.grids(CONDITIONS, {"mean": Store(folder)})
    for grid in grids:
        for number, run in enumerate(grid.runs):
            harm = 0.0 if run.attack == "none" else (number * 37 % 100) / 100
            frames = {
                "attackers": (number % 2, 3, 4)[: run.k],
                "damage": (0.0, harm, harm),
                "error": f"defender Wall failed in frame 2: ```{HOSTILE}, at m.py:3 in f" if number == 3 else None,
                "informed": run.defender == "seer",
            }
            made = [record(s, "110" if harm < 0.5 else "01", 3 + len(s) % 2, **frames) for s in run.names]
            grid.store.write(run, grid.conditions, made)
    failed = f"{HOSTILE} against no attack: it broke"
    results = collect_results(grids, folder, resamples=20, failed=failed, rank_by=("damage", "ap50"))
    gif = write_gif([np.full((80, 120, 3), shade, np.uint8) for shade in (20, 200)], folder / "video.gif")
    worst = {name: Worst(grid.runs[0], 0.5, gif) for name, grid in zip(DEFENDERS, grids, strict=False)}
    results = replace(results, worst=worst)
    provenance = about(CONDITIONS, f"cp-arena --defenders '{HOSTILE}'", seeds=[0], workers=2, threads=1)
    write_markdown(results, folder / "arena.md", provenance)
    write_json(results, folder, provenance)
    drawn = draw_plots(results)
    write_leaderboard(results, drawn, folder / "leaders.md", provenance)
    return write_html(results, drawn, folder, provenance)


class Reader(HTMLParser):
    """Collects tags and what they refer to."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.links: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.links += [value or "" for name, value in attrs if name in ("src", "href")]
        assert not any(name.startswith("on") for name, _ in attrs)


def test_everything_is_inside_and_names_are_text(page: Path) -> None:
    text = page.read_text()
    read = Reader(text)
    assert all(link.startswith(("data:", "#")) for link in read.links)
    assert read.tags.count("script") == 1 and HOSTILE not in text
    assert read.tags.count("img") == sum(link.startswith("data:image") for link in read.links) == 3 + 2 + 4
    assert "hacked = 1&lt;/script&gt;" in text
    for svg in re.findall(r"data:image/svg\+xml;base64,([^\"]+)", text):
        assert b"<script" not in base64.b64decode(svg)
    for gif in re.findall(r"data:image/gif;base64,([^\"]+)", text):
        assert Image.open(io.BytesIO(base64.b64decode(gif))).n_frames == 2
    assert all(version in text for version in ("torch", "numpy", "threads", "seeds", "workers"))


def test_episodes_that_a_defender_ended_are_said(page: Path) -> None:
    """Each of the four grids has a run of two of them."""
    text = (page.parent / "arena.md").read_text()
    line = next(line for line in text.splitlines() if " ended " in line)
    assert "**Failed episodes.** A defender that fails ends its episode" in text
    assert line.startswith("defender ") and " ended 8 of its 32 episodes: " in line
    assert line.endswith(f"'''{HOSTILE}, at m.py:3 in f")
    (told,) = json.loads((page.parent / "arena.json").read_text())["failed_episodes"]
    assert told == line.replace("'''", "```")
    shown = page.read_text()
    assert shown.index(">Not played<") < shown.index(">Failed episodes<") < shown.index(">Defenders<")
    assert "at m.py:3 in f</p>" in shown


def test_the_same_results_give_the_same_bytes(page: Path) -> None:
    svg = (page.parent / "leaders" / "trade-off.svg").read_text()
    assert "<dc:date>" not in svg and svg.count("<g id=") > 10


def test_markdown_tables_hold_together_whatever_the_names(page: Path) -> None:
    for file in ("arena.md", "leaders.md"):
        tables = re.findall(r"(?:^\|.*\n)+", (page.parent / file).read_text(), re.MULTILINE)
        assert len(tables) == 2 + 2 + 2 + 1 + 3  # the last: by AP, pairs of defenders, by the ego
        for table in tables:
            lines = table.splitlines()
            assert len({len(re.findall(r"(?<!\\)\|", line)) for line in lines}) == 1
            assert "<script>" not in table


def test_the_page_says_how_attacks_were_picked_and_what_intervals_and_ranks_mean(page: Path) -> None:
    text = (page.parent / "arena.md").read_text()
    for words in (
        "picked on the scenes that are reported on",
        "Gaffke's 95 % interval, which stays in [0, 1]",
        "with Holm's correction",
        "Fewer than six scenes tell nobody apart",
        "exact bounds of Clopper and Pearson",
        "## Defenders by AP@.5",
        "## Pairs of defenders",
        "## By the ego",
    ):
        assert words in text and words.removeprefix("## ").replace("'", "&#x27;") in page.read_text()
    assert "| 1–3 | 0." in text, "two scenes leave every place open"


def test_a_screened_ranking_names_the_attack_and_the_scenes(tmp_path: Path) -> None:
    axes = Axes(defenders=("none", "wall"), attacks=("loud", "sly"), ks=(2, 1))
    grids = axes.grids(CONDITIONS, {"mean": Store(tmp_path)})
    elsewhere = replace(grids[0], store=Store(tmp_path / "screening"))
    for grid, harms in ((elsewhere, {"loud": 0.9, "sly": 0.1}), *((grid, {"loud": 0.2, "sly": 0.8}) for grid in grids)):
        for run in grid.runs:
            harm = harms.get(run.attack, 0.0)
            made = [record(s, "1", 2, attackers=(0, 3)[: run.k], damage=(0.0, harm, harm)) for s in run.names]
            grid.store.write(run, grid.conditions, made)
    results = collect_results(grids, tmp_path, resamples=10, screening=elsewhere)
    assert {line.damage.mean for line in results.defenders} == {0.2}, "what was worst elsewhere, not here"
    assert {curve.under for curve in results.curves} == {
        "under the attack that was worst on the screening scenes (loud: none, wall)"
    }
    text = write_markdown(results, tmp_path / "arena.md", about(CONDITIONS, "cp-arena")).read_text()
    assert "Each defender meets the attack that was worst for it on 2 scenes of toy" in text
    assert "detection loss/frame, screened attack" in text and "| loud |" in text
    data = json.loads(write_json(results, tmp_path, about(CONDITIONS, "cp-arena"))[0].read_text())
    assert data["screening"]["names"] == ["toy-0", "toy-1"] and data["ranked_by"] == "damage"
    assert {pair["adjusted"] for pair in data["differences"]} == {1.0}


# ── in a real browser ────────────────────────────────────────────────────────────────────────────────────────────────

BROWSER = pytest.mark.skipif(not (CHROMIUM and DRIVER), reason="no chromium and chromedriver: apt-get install them")


@pytest.fixture(scope="module")
def window(page: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with browser(tmp_path_factory.mktemp("browser") / "profile") as opened:
        opened.open(page)
        yield opened


@BROWSER
def test_it_opens_without_a_complaint_and_asks_for_nothing(window: Browser, page: Path) -> None:
    assert window.run("return document.title") == "Arena"
    assert window.log("browser") == []
    asked = [url for url in window.requests() if not url.startswith(("data:", "chrome:"))]  # the browser's own pages
    assert asked == [page.resolve().as_uri()]
    assert window.run("return typeof hacked") == "undefined"
    drawn = window.run("return [...document.images].map(i => i.complete && i.naturalWidth > 0)")
    assert len(drawn) == 9 and all(drawn)
    assert HOSTILE in window.run("return [...document.querySelectorAll('td')].map(d => d.textContent)")


COLUMN = """
const table = document.querySelector(arguments[0]);
return [...table.tBodies[0].rows].map(row => row.cells[arguments[1]].textContent);
"""


@BROWSER
def test_a_click_on_a_heading_sorts_by_it_and_another_reverses_it(window: Browser) -> None:
    table, heading = "#all-results table", "#all-results th:nth-child({}) button"

    def column(number: int) -> list[str]:
        shown: list[str] = window.run(COLUMN, table, number - 1)
        return shown

    before = column(7)  # AP@.5 with its interval
    means = [float(text.split()[0]) for text in before]
    assert means != sorted(means)
    window.click(heading.format(7))
    assert [float(text.split()[0]) for text in column(7)] == sorted(means)
    window.click(heading.format(7))
    assert [float(text.split()[0]) for text in column(7)] == sorted(means, reverse=True)
    for turn in (1, 2):  # AP recovery: empty without an attack, and that stays last
        window.click(heading.format(9))
        shown = column(9)
        values = [float(text.split()[0]) for text in shown if text != "–"]
        assert 0 < len(values) < len(shown) and shown[len(values) :] == ["–"] * (len(shown) - len(values))
        assert values == sorted(values, reverse=turn == 2)
    window.click(heading.format(1))
    assert column(1) == sorted(column(1), key=(HOSTILE, "none", "seer", "wall").index)
    sorted_by = window.run("return [...document.querySelectorAll('#all-results [aria-sort]')].map(h => h.cellIndex)")
    assert sorted_by == [0]


@BROWSER
@pytest.mark.parametrize("width", [420, 1280])
def test_it_fits_a_narrow_and_a_wide_window(window: Browser, width: int) -> None:
    window.resize(width, 900)
    assert window.run("return document.documentElement.scrollWidth <= innerWidth")
    inside = (
        "return [...document.querySelectorAll('p, h1, h2, td, th, dd')].filter(e => e.scrollWidth > e.clientWidth + 1)"
    )
    squeezed: list[Any] = window.run(f"{inside}.map(e => e.textContent)")
    assert squeezed == []
