"""A page in one file: style, script, images and videos are inside, and nothing is fetched. All text is escaped."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from html import escape
from pathlib import Path

from cp_env.evaluation.report.tables import Entry, Heading, Table

HERE = Path(__file__).parent
POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'"
"""What the page may load: nothing but what it holds itself."""


def table(content: Table) -> str:
    """A table whose headings sort it."""
    head = "".join(
        f'<th scope="col"{_class(h)}><button type="button">{escape(h.text)}</button></th>' for h in content.headings
    )
    body = "".join(
        "<tr>" + "".join(_entry(h, e) for h, e in zip(content.headings, row, strict=True)) + "</tr>\n"
        for row in content.rows
    )
    title = f"<caption>{escape(content.caption)}</caption>" if content.caption else ""
    return f'<div class="wide"><table>{title}<thead><tr>{head}</tr></thead>\n<tbody>{body}</tbody></table></div>\n'


def _class(heading: Heading) -> str:
    return ' class="number"' if heading.number else ""


def _entry(heading: Heading, entry: Entry) -> str:
    value = f' data-value="{entry.value!r}"' if entry.value is not None else ""
    shade = "" if entry.shade is None else f' style="background: rgba(214, 96, 77, {0.75 * entry.shade:.3f})"'
    return f"<td{_class(heading)}{value}{shade}>{escape(entry.text)}</td>"


def section(title: str, *parts: str) -> str:
    """A part of the page with a heading that the list at its top leads to."""
    return f'<section id="{_anchor(title)}"><h2>{escape(title)}</h2>\n{"".join(parts)}</section>\n'


def paragraph(text: str, kind: str = "") -> str:
    """A paragraph of the page's style `kind`."""
    return f'<p class="{kind}">{escape(text)}</p>\n'


def preformatted(text: str) -> str:
    """Text whose lines and blanks stay as they are."""
    return f"<pre>{escape(text)}</pre>\n"


def facts(pairs: Sequence[tuple[str, str]]) -> str:
    """Names and their values."""
    return "<dl>" + "".join(f"<dt>{escape(name)}</dt><dd>{escape(what)}</dd>" for name, what in pairs) + "</dl>\n"


def picture(data: str | bytes, kind: str, alt: str, caption: str = "") -> str:
    """An image, inline: `kind` is "svg+xml", "gif" or "png"."""
    content = base64.b64encode(data.encode() if isinstance(data, str) else data).decode()
    below = f"<figcaption>{escape(caption)}</figcaption>" if caption else ""
    return f'<figure><img src="data:image/{kind};base64,{content}" alt="{escape(alt)}">{below}</figure>\n'


def plot(svg: str, alt: str) -> str:
    """A plot that keeps its size on a narrow screen, where it scrolls."""
    return f'<div class="wide plot">{picture(svg, "svg+xml", alt)}</div>\n'


def videos(figures: Sequence[str]) -> str:
    """Figures side by side, as many as there is room for."""
    return f'<div class="videos">{"".join(figures)}</div>\n'


def page(title: str, lead: str, sections: Sequence[tuple[str, Sequence[str]]]) -> str:
    """The whole file; sections are titles and parts."""
    links = "".join(f'<a href="#{_anchor(name)}">{escape(name)}</a>' for name, _ in sections)
    parts = "".join(section(name, *inside) for name, inside in sections)
    style, script = (HERE / "page.css").read_text(), (HERE / "page.js").read_text()
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">\n'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f'<title>{escape(title)}</title>\n<link rel="icon" href="data:,">\n<style>\n{style}</style></head>\n'
        f"<body><h1>{escape(title)}</h1>\n{paragraph(lead, 'faint')}<nav>{links}</nav>\n{parts}"
        f"<script>\n{script}</script></body></html>\n"
    )


def _anchor(title: str) -> str:
    return "".join(c if c.isalnum() else "-" for c in title.lower())
