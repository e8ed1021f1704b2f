"""A hook of MkDocs: links from a page to a file of the repository (`../examples/…`) lead to that file as a page.

On the repository's own site such links work as they stand; in the built site they would lead outside it.
"""

from __future__ import annotations

import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files, InclusionLevel
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parent.parent
LINK = re.compile(r"\]\(\.\./([\w./-]+)\)")
FOLDER = "source"


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add a page for every file that some page links to."""
    for linked in sorted({name for page in files.documentation_pages() for name in LINK.findall(page.content_string)}):
        content = (ROOT / linked).read_text()
        language = Path(linked).suffix.lstrip(".")
        text = content if language == "md" else f"# {linked}\n\n```{language}\n{content}\n```\n"
        file = File.generated(config, f"{FOLDER}/{linked}.md", content=text, inclusion=InclusionLevel.NOT_IN_NAV)
        files.append(file)
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Point the links there."""
    del config, files
    return markdown if page.file.generated_by else LINK.sub(rf"]({FOLDER}/\1.md)", markdown)
