"""The documentation's code, found and run: Python blocks page by page, console lines by what their programs accept.

Conventions of the pages:

    n = 5_000  # three minutes; 64 in the tests      a number that would take minutes: the tests put the second in
    ```sh … ```                                      every program must exist and take the arguments given
    ```text … ```                                    output: not checked here
"""

from __future__ import annotations

import re
import shlex
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import tyro

ROOT = Path(__file__).parents[2]
FENCE = re.compile(r"^```(\w+)[^\n]*\n(.*?)^```", re.DOTALL | re.MULTILINE)
INLINE = re.compile(r"`((?:python (?:examples/|-m )|make |cp-(?:arena|benchmark|calibrate|env|play|train) )[^`\n]+)`")
IN_TESTS = re.compile(r"^(\s*\w+ = )[^#\n]+(#[^\n]*?)(\S+) in the tests$", re.MULTILINE)


def pages() -> list[str]:
    """README and every page, as paths from the root."""
    return ["README.md", *sorted(str(file.relative_to(ROOT)) for file in (ROOT / "docs").rglob("*.md"))]


def blocks(page: str, *languages: str) -> Iterator[tuple[int, str]]:
    """The line before each block's first, and its text."""
    text = (ROOT / page).read_text()
    for found in FENCE.finditer(text):
        if found[1] in languages:
            yield text.count("\n", 0, found.start(2)), found[2]


def in_tests(code: str) -> str:
    """The code with the numbers that its comments name for the tests."""
    return IN_TESTS.sub(r"\g<1>\g<3>  \g<2>", code)


def run_page(page: str, names: dict[str, Any] | None = None, paths: dict[str, str] | None = None) -> dict[str, Any]:
    """Run the Python of a page, block after block, and hand back its names.

    Args:
        page: path from the root.
        names: what the page takes for granted, besides `cp_env`.
        paths: strings to put in the place of others, such as a folder of data that is not here.
    """
    import cp_env

    module = ModuleType("page_" + Path(page).stem.replace("-", "_"))  # known by name, so that its classes pickle
    sys.modules[module.__name__] = module
    module.__dict__.update({"cp_env": cp_env, **(names or {})})
    for line, code in blocks(page, "python"):
        code = in_tests(code)
        for old, new in (paths or {}).items():
            code = code.replace(old, new)
        exec(compile("\n" * line + code, page, "exec"), module.__dict__)
    return module.__dict__


def commands(page: str) -> Iterator[list[str]]:
    """The words of every command in a page's console blocks and inline code."""
    for _, text in blocks(page, "sh"):
        yield from _split(re.sub(r"\\\n", " ", text))
    for found in INLINE.finditer((ROOT / page).read_text()):
        if "…" not in found[1]:
            yield from _split(found[1])


def _split(text: str) -> Iterator[list[str]]:
    for line in text.splitlines():
        lexer = shlex.shlex(line, posix=True, punctuation_chars=";&|")
        lexer.whitespace_split = True
        words: list[str] = []
        for word in [*lexer, ";"]:
            if not set(word) <= set(";&|"):
                words.append(word)
                continue
            if words := _program(words):
                yield words
            words = []


def _program(words: list[str]) -> list[str]:
    """Without what the shell keeps for itself: settings, `for`, `do`, `done`."""
    while words and (words[0] in ("do", "done") or re.fullmatch(r"[A-Z_]+=\S*", words[0])):
        words = words[1:]
    return [] if words[:1] == ["for"] else words


def accepts(args: Any, given: list[str]) -> None:
    """ValueError unless a program's `Args` can be made from these arguments."""
    given = ["0" if re.fullmatch("[A-Z]", word) else word for word in given]  # --seed S
    try:
        tyro.cli(args, args=given, console_outputs=False)
    except SystemExit as error:
        if error.code:
            raise ValueError(f"{args.__module__} does not take {shlex.join(given)}") from error
