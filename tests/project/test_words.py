"""One vocabulary, the field's: no identifier and no page uses a word of our own where papers have another.

This file holds the words, so it is the one file that is not read.
"""

from __future__ import annotations

import functools
import keyword
import re
import subprocess
import tokenize
from collections.abc import Callable, Iterator
from fnmatch import fnmatchcase
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parents[2]
SELF = Path(__file__).relative_to(ROOT).as_posix()

IDENTIFIERS = {
    "accuse": "flag",
    "accused": "flagged",
    "accuses": "flags",
    "aside": "full_view",
    "beside": "full_view",
    "board": "grid",
    "boards": "grids",
    "coin": "rng",
    "coins": "rng",
    "crew": "workers",
    "crews": "workers",
    "dearest": "costliest",
    "door": "API",
    "doors": "APIs",
    "duel": "pairwise result",
    "duels": "pairwise results",
    "eyes": "detector",
    "foresee": "views_under",
    "foresight": "counterfactual",
    "glitch": "outlier",
    "glitches": "outliers",
    "guilt": "attacker_probability",
    "hands": "attacks",
    "honest": "benign",
    "innocent": "benign",
    "innocents": "benign",
    "knob": "option",
    "knobs": "options",
    "liar": "attacker",
    "liars": "attackers",
    "likeness": "similarity",
    "look": "verification",
    "looks": "verifications",
    "lying": "malicious",
    "manner": "mode",
    "manners": "modes",
    "martyr": "sacrificed",
    "martyrs": "sacrificed",
    "minds": "defenders",
    "odd": "outlier",
    "reel": "sequence",
    "reels": "sequences",
    "rehearse": "simulate",
    "sheet": "table",
    "sheets": "tables",
    "silence": "no_perturbation",
    "tape": "recorder",
    "tapes": "recorders",
    "tell": "reveal",
}
"""Parts of identifiers that are words of our own, and the field's."""


class Phrase(NamedTuple):
    """A word of our own in prose."""

    example: str  # holds it
    pattern: str
    instead: str


PROSE = (
    Phrase("two liars", r"liars?", "attacker, malicious vehicle"),
    Phrase("a lying vehicle", r"lying (?:vehicle|agent|car|sender|partner)s?", "malicious vehicle"),
    Phrase("a quiet lie", r"(?:an?|the|no|any|each|every|their|his|its|quiet|loud|stealthy) lies?", "perturbation"),
    Phrase("lies of two vehicles", r"lies (?:of|that|to)", "perturbations"),
    Phrase(
        "who lies is unknown",
        r"(?:who|attackers?|vehicles? (?:that|which|who)) (?:lies?|lied)",
        "attacks, is malicious",
    ),
    Phrase("to lie pays", r"to lie", "to attack"),
    Phrase("an honest vehicle", r"honest(?:ly)?", "benign"),
    Phrase("three innocents", r"innocents?", "benign vehicle"),
    Phrase("it is accused of it", r"accused?|accuses", "flagged, identified"),
    Phrase("a knob of the defender", r"knobs?", "option, parameter"),
    Phrase("a coin is tossed", r"coins?", "rng, random number generator"),
    Phrase("one glitch", r"glitch(?:es)?", "outlier"),
    Phrase("an odd view", r"odd (?:views?|frames?|outputs?|predictions?|verifications?|readings?|ones?)", "outlier"),
    Phrase("the crew", r"crews?", "workers"),
    Phrase("a reel", r"reels?", "frame sequence"),
    Phrase("a tape", r"tapes?", "recorder"),
    Phrase("a sheet", r"sheets?", "table"),
    Phrase("the board", r"(?<!\bon )boards?", "grid"),
    Phrase("a martyr", r"martyrs?", "sacrificed vehicle"),
    Phrase("its eyes", r"eyes", "detector"),
    Phrase("two minds", r"minds", "defenders"),
    Phrase("the hands that attack", r"hands (?:that|of)|(?:the|your|their|its) hands", "attacks"),
    Phrase("a manner of attack", r"manners?", "mode"),
    Phrase("the view aside", r"aside", "full view"),
    Phrase("the door for yours", r"doors?", "API"),
    Phrase("the dearest attack", r"dearest", "costliest"),
    Phrase("the duels", r"duels?", "pairwise results"),
    Phrase("a star design", r"star designs?", "one-factor-at-a-time"),
    Phrase("side attackers", r"side[- ]attack(?:er)?s?", "off-baseline attacks"),
    Phrase(
        "at most two looks", r"(?:\d+|two|three|four|five|no|more|most|fewer|free|each|every) looks?", "verification"
    ),
    Phrase("a look is paid", r"(?:per|first|second|one|an?|its|last|further) looks?(?! (?:at|into)\b)", "verification"),
    Phrase("bayes:looks=8", r"looks?(?==|/)", "max_verifications"),
    Phrase("| looks |", r"(?<=\| )looks?(?= \|)", "verifications/frame"),
    Phrase("the defence is told who attacks", r"(?:tells?|told)(?: it| us| them)? who", "reveals"),
    Phrase("a rehearsal of it", r"rehears(?:es?|ed|als?|ing)", "simulate"),
    Phrase("the guilt of it", r"guilt", "attacker probability"),
    Phrase("pgd:likeness", r"likeness", "similarity"),
)
"""Words of our own in docstrings, comments, messages, table heads and pages."""


class Exempt(NamedTuple):
    """Words that are meant, and why."""

    where: str  # pattern of paths
    text: str  # pattern of the text that holds the word, or of the identifier
    reason: str


EXEMPT = (
    Exempt("*", r"All (?:Connected )?Vehicles Can Lie", "the paper's title"),
    Exempt("*", r"\w*(?:TensorBoard|tensorboard)\w*", "a program's name"),
    Exempt("CHANGELOG.md", r"`[^`\n]+`(?: and `[^`\n]+`)? (?:is|are)(?: the \w+)? `", "a rename, from the old name"),
    Exempt("CHANGELOG.md", r"(?s)^## \[0\.1\.0\].*", "history is not rewritten"),
    Exempt("*", r"vehicles_drive_where_they_look", "a rule's name: vehicles face the road"),
    Exempt("cp_env/detector/coperception/backbone.py", r"\bodd\b", "the parity of a row"),
    Exempt("agents/learning/tuning.py", r"\btell\b", "Optuna's name for storing a trial's result"),
)


class Finding(NamedTuple):
    """A word of our own, and where it is."""

    file: str
    line: int
    word: str
    instead: str

    def __str__(self) -> str:
        return f"{self.file}:{self.line}: {self.word} (say {self.instead})"


class Text(NamedTuple):
    """A stretch of a file and the line on which it begins."""

    line: int
    text: str


# -- what a file says ------------------------------------------------------------------------------------------------


@functools.cache
def _python(file: Path) -> tuple[tuple[Text, ...], tuple[Text, ...]]:
    """Names of a Python file; and its strings and comments."""
    names, prose = [], []
    with tokenize.open(file) as lines:
        for token in tokenize.generate_tokens(lines.readline):
            text = Text(token.start[0], token.string)
            if token.type == tokenize.NAME and not keyword.iskeyword(token.string):
                names.append(text)
            elif token.type in (tokenize.STRING, tokenize.COMMENT, getattr(tokenize, "FSTRING_MIDDLE", -1)):
                prose.append(text)
    return tuple(names), tuple(prose)


def _names_in_pages(text: str) -> Iterator[Text]:
    """Names in the blocks and spans of code of a page, comments apart."""
    for code in re.finditer(r"^(`{3,})\w*\n(.*?)^\1|`([^`\n]+)`", text, re.MULTILINE | re.DOTALL):
        start = text.count("\n", 0, code.start(3) if code[2] is None else code.start(2)) + 1
        for row, line in enumerate((code[3] if code[2] is None else code[2]).splitlines()):
            for name in re.findall(r"[A-Za-z_]\w*", re.sub(r"(?:^|\s)#.*", "", line)):
                yield Text(start + row, name)


def parts(name: str) -> list[str]:
    """Words of an identifier, split at underscores and at camel case."""
    return [part.lower() for part in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", name)]


# -- what is wrong with it -------------------------------------------------------------------------------------------


def _exempt(file: str, text: str) -> str:
    """The text, with what is meant blotted out, line for line."""
    for exempt in EXEMPT:
        if fnmatchcase(file, exempt.where):
            pattern = exempt.text.replace(" ", r"\s+")
            text = re.sub(pattern, lambda meant: "\n" * meant[0].count("\n"), text, flags=re.MULTILINE)
    return text


def _identifiers(file: str, names: Iterator[Text] | tuple[Text, ...]) -> Iterator[Finding]:
    for line, name in names:
        for part in parts(_exempt(file, name)):
            if part in IDENTIFIERS:
                yield Finding(file, line, f"{part!r} in {name}", IDENTIFIERS[part])


ANY = re.compile(
    "|".join(rf"(?P<_{i}>(?<![\w`-]){phrase.pattern}(?!\w))" for i, phrase in enumerate(PROSE)),
    re.IGNORECASE,
)


def _prose(file: str, texts: Iterator[Text] | tuple[Text, ...]) -> Iterator[Finding]:
    for line, text in texts:
        text = _exempt(file, text)
        for found in ANY.finditer(re.sub(r"\s", " ", text)):
            phrase = PROSE[int(str(found.lastgroup)[1:])]
            yield Finding(file, line + text.count("\n", 0, found.start()), repr(found[0]), phrase.instead)


def in_identifiers(root: Path, file: str) -> Iterator[Finding]:
    if file.endswith(".py"):
        yield from _identifiers(file, _python(root / file)[0])


def in_python_prose(root: Path, file: str) -> Iterator[Finding]:
    if file.endswith(".py"):
        yield from _prose(file, _python(root / file)[1])


def in_pages(root: Path, file: str) -> Iterator[Finding]:
    if file.endswith(".md"):
        text = (root / file).read_text(encoding="utf-8")
        yield from _prose(file, (Text(1, text),))
        yield from _identifiers(file, _names_in_pages(_exempt(file, text)))


SETTINGS = (".toml", ".yml", ".yaml", ".cff", ".css", ".js", ".txt", ".svg", "Makefile", ".ci/run")


def in_settings(root: Path, file: str) -> Iterator[Finding]:
    """Configuration, style sheets, scripts and drawings: the prose in them."""
    if file.endswith(SETTINGS):
        yield from _prose(file, (Text(1, (root / file).read_text(encoding="utf-8")),))


def in_paths(root: Path, file: str) -> Iterator[Finding]:
    yield from _identifiers(file, (Text(0, file),))


KINDS: dict[str, Callable[[Path, str], Iterator[Finding]]] = {
    "identifiers": in_identifiers,
    "docstrings, comments and strings": in_python_prose,
    "pages": in_pages,
    "settings": in_settings,
    "paths": in_paths,
}


def tree() -> list[str]:
    """Every file of the repository but this one, those not yet added included."""
    listed = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    run = subprocess.run(listed, cwd=ROOT, capture_output=True, text=True, timeout=60)
    if run.returncode:
        pytest.skip("needs a git checkout")
    return sorted(file for file in set(run.stdout.split("\0")) - {"", SELF} if (ROOT / file).is_file())


@pytest.mark.parametrize("kind", KINDS)
def test_the_words_are_the_fields(kind: str) -> None:
    found = [str(finding) for file in tree() for finding in KINDS[kind](ROOT, file)]
    assert not found, f"{len(found)} words of our own:\n" + "\n".join(found)


# -- the checker itself ----------------------------------------------------------------------------------------------


def _planted(folder: Path, name: str, content: str, kind: str) -> list[Finding]:
    (folder / name).write_text(content)
    return list(KINDS[kind](folder, name))


@pytest.mark.parametrize("word", IDENTIFIERS)
def test_a_planted_identifier_is_found(word: str, tmp_path: Path) -> None:
    for i, name in enumerate((word, f"first_{word}", f"{word}_of_all", f"Every{word.title()}Thing", word.upper())):
        (found,) = _planted(tmp_path, f"planted_{i}.py", f"first = 1\n{name} = first\n", "identifiers")
        assert (found.line, found.instead) == (2, IDENTIFIERS[word])
        (found,) = _planted(tmp_path, f"block_{i}.md", f"Page\n```python\nfirst = 1\n{name} = first\n```\n", "pages")[
            -1:
        ]
        assert found.line == 4
    assert list(in_paths(tmp_path, f"folder/{word}_of_all.py"))
    assert not _planted(tmp_path, "other.py", f"x{word}y = 1\n", "identifiers")


IN_PYTHON = "docstrings, comments and strings"
FRAMES = (
    ("docstring.py", 'def f():\n    """First.\n\n    It is {}, here.\n    """\n', IN_PYTHON, 4),
    ("comment.py", "x = 1\ny = 2  # {}: so\n", IN_PYTHON, 2),
    ("message.py", "raise ValueError(\n    '{}.'\n)\n", IN_PYTHON, 2),
    ("message_with_values.py", "x = 1\nprint(f'{{x}} {}, {{x}}')\n", IN_PYTHON, 2),
    ("page.md", "# Page\n\nFirst\n{}.\n", "pages", 4),
    ("head.md", "| first | {} | last |\n|---|---|---|\n", "pages", 1),
    ("page.css", "a {{ color: red }}\n/* {} */\n", "settings", 2),
)


@pytest.mark.parametrize("phrase", PROSE, ids=lambda phrase: phrase.example)
def test_a_planted_phrase_is_found(phrase: Phrase, tmp_path: Path) -> None:
    """Wherever it stands, and across two lines of a docstring or a page; a head of a table, in a table."""
    example = phrase.example.strip("| ")
    for name, frame, kind, line in FRAMES:
        if example == phrase.example or name == "head.md":
            found = _planted(tmp_path, name, frame.format(example), kind)
            assert (line, phrase.instead) in {(finding.line, finding.instead) for finding in found}, name
            if name in ("docstring.py", "page.md"):
                found = _planted(tmp_path, f"broken_{name}", frame.format(example.replace(" ", "\n")), kind)
                assert phrase.instead in {finding.instead for finding in found}, name


@pytest.mark.parametrize(
    "text",
    [
        "The paper is *All Vehicles Can Lie*.",
        "The paper is *All Vehicles\nCan Lie*.",
        "It is drawn in TensorBoard, from the keyboard, with a dashboard on board.",
        "Points lie in the box; the point lies in it. The truth lies where the sensors hit, at odd columns.",
        "It looks at the sea and looks north; a look at the table; drivers look around. Tell them apart.",
        "A benign vehicle is verified beside an attacker.",
        "Every hand-made case passes on its options; it hands its options to `reset`.",
    ],
)
def test_plain_english_passes(text: str, tmp_path: Path) -> None:
    assert not _planted(tmp_path, "plain.md", text, "pages")
    assert not _planted(tmp_path, "plain.py", f'"""{text}"""\n', "docstrings, comments and strings")


def test_what_is_exempt_is_needed_and_has_a_reason() -> None:
    """An exemption that matches no file any more is dropped from the table."""
    texts = {file: (ROOT / file).read_text(errors="ignore") for file in tree() if file.endswith((".py", ".md", ".cff"))}
    for exempt in EXEMPT:
        assert exempt.reason
        pattern = re.compile(exempt.text.replace(" ", r"\s+"), re.MULTILINE)
        assert any(fnmatchcase(file, exempt.where) and pattern.search(text) for file, text in texts.items()), exempt
