"""The built site in a real browser: on a desk and on a telephone nothing is cut, and pages lead on to the next.

Skipped without mkdocs (`make docs` installs it into `.venv-docs`), and without chromium and chromedriver.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.helpers.browser import CHROMIUM, DRIVER, Browser, browser

ROOT = Path(__file__).parents[2]
OWN = ROOT / ".venv-docs/bin/mkdocs"
MKDOCS = str(OWN) if OWN.is_file() else shutil.which("mkdocs")

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not (CHROMIUM and DRIVER), reason="no chromium and chromedriver: apt-get install them"),
    pytest.mark.skipif(MKDOCS is None, reason="no mkdocs: make docs"),
]

WIDTHS = (1280, 390)
"""A desk, a telephone; CSS pixels."""

CUT = """
const wide = document.documentElement.clientWidth, found = [];
const name = e => e.tagName.toLowerCase() + ': ' + e.textContent.trim().slice(0, 60);
if (document.documentElement.scrollWidth > wide + 1) found.push('the page is ' + document.documentElement.scrollWidth);
for (const e of document.querySelectorAll('article table, article pre, article pre > code, article img')) {
  if (!e.getClientRects().length) continue;
  let box = e.tagName === 'TABLE' ? e.parentElement : e;  // the nearest that may scroll sideways
  const scrolls = box => ['auto', 'scroll'].includes(getComputedStyle(box).overflowX);
  while (box.tagName !== 'ARTICLE' && !scrolls(box)) box = box.parentElement;
  const inside = box.tagName !== 'ARTICLE';
  const edge = (inside ? box : e).getBoundingClientRect().right;
  if (edge > wide + 1) found.push(name(e) + ' ends at ' + Math.round(edge));
  const broken = e.clientWidth && e.scrollWidth > e.clientWidth + 1;
  if (e.tagName !== 'TABLE' && broken) found.push(name(e) + ' is ' + e.scrollWidth);
}
for (const e of document.querySelectorAll('nav a, header a')) {
  if (!e.getClientRects().length || e.closest('.md-sidebar--primary') && wide < 1220) continue;  // a drawer slides in
  if (e.getBoundingClientRect().right > wide + 1) found.push(name(e) + ' is out of the window');
}
return [wide, found];
"""
"""What is cut: an element that reaches beyond the window and cannot be scrolled to, and any line of code not whole.

A table of many columns may scroll in its own box. A bar of links may not: nothing shows that it scrolls.
"""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site, built strictly."""
    folder = tmp_path_factory.mktemp("site")
    assert MKDOCS
    built = subprocess.run(
        [MKDOCS, "build", "--quiet", "--strict", "--site-dir", str(folder)],
        cwd=ROOT,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        timeout=900,
    )
    assert built.returncode == 0, built.stdout + built.stderr
    return folder


@pytest.fixture(scope="module")
def window(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with browser(tmp_path_factory.mktemp("browser") / "profile") as opened:
        yield opened


def cut(window: Browser, page: Path, width: int) -> list[str]:
    """What is cut on a page in a window of that width."""
    window.emulate(width, 900)
    window.open(page)
    wide, found = window.run(CUT)
    assert wide <= width
    return list(found)


@pytest.mark.parametrize("width", WIDTHS)
def test_nothing_is_cut(site: Path, window: Browser, width: int) -> None:
    pages = [page for page in sorted(site.rglob("*.html")) if "source" not in page.relative_to(site).parts]
    assert len(pages) > 30
    found: dict[str, Any] = {str(page.relative_to(site)): cut(window, page, width) for page in pages}
    assert not {page: cuts for page, cuts in found.items() if cuts}


@pytest.mark.parametrize(
    ("body", "complaint"),
    [
        ("<pre style='overflow:hidden'><code>" + "long " * 200 + "</code></pre>", "pre: long"),
        ("<table><tr>" + "<td>wide_______________</td>" * 40 + "</tr></table>", "table: wide"),
        ("<div style='width:3000px'>w</div>", "the page is"),
        ("<nav style='overflow:hidden; white-space:nowrap'>" + "<a href='#'>long</a> " * 40 + "</nav>", "a: long"),
    ],
)
def test_what_is_cut_is_seen(window: Browser, tmp_path: Path, body: str, complaint: str) -> None:
    page = tmp_path / "page.html"
    head = "<meta name='viewport' content='width=device-width'>"
    page.write_text(f"<!doctype html><html><head>{head}</head><body><article>{body}</article></body></html>")
    assert any(one.startswith(complaint) for one in cut(window, page, 390))
    page.write_text(f"<!doctype html><html><head>{head}</head><body><article><p>short</p></article></body></html>")
    assert cut(window, page, 390) == []


def test_a_page_leads_on_and_says_the_version(site: Path, window: Browser) -> None:
    window.emulate(WIDTHS[0], 900)
    window.open(site / "faq.html")
    links = window.run("return [...document.querySelectorAll('.md-footer__link')].map(link => link.textContent.trim())")
    assert [link.split()[0] for link in links] == ["Previous", "Next"]
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert f"cp-env {version}" in window.run("return document.querySelector('footer').textContent")
    window.click(".md-footer__link--next")
    assert window.run("return document.querySelector('h1').textContent").startswith("Known limits")
