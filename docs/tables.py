"""A hook of MkDocs: where the lines of a narrow table break.

An interval stays in one piece, and so does "< 0.01". A long name in code breaks after its punctuation, not within a
word.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import Files
    from mkdocs.structure.pages import Page

CELL = re.compile(r"(<td[^>]*>)(.*?)(</td>)", re.DOTALL)
INTERVAL = re.compile(r"(\[[-−+]?[\d.,]*\d), ([-−+]?[\d.,]*\d\])")
BOUND = re.compile(r"(&lt;|&gt;) (?=[\d.])")
CODE = re.compile(r"(<code>)([^<]*)(</code>)")
MARKS = re.compile(r"(?<=[:=/.,_])(?=\w)")


def on_page_content(html: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """The page with its tables' cells prepared."""
    del page, config, files
    return CELL.sub(lambda found: found[1] + prepared(found[2]) + found[3], html)


def prepared(cell: str) -> str:
    """A cell's HTML, with spaces that hold and places where names may break."""
    held = BOUND.sub("\\1\u00a0", INTERVAL.sub("\\1,\u00a0\\2", cell))
    return CODE.sub(lambda found: found[1] + MARKS.sub("<wbr>", found[2]) + found[3], held)
