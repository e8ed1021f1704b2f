"""The tables of a campaign, written between two marks of a page."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from tests.campaign.case import Result
from tests.campaign.ledger import total

BEGIN, END = "<!-- campaign: begin -->", "<!-- campaign: end -->"
Row = tuple[str, ...]


def write_tables(page: Path, results: Sequence[Result]) -> None:
    """Replace what stands between the marks of a page.

    Raises:
        ValueError: the page has no such marks.
    """
    text = page.read_text(encoding="utf-8")
    if text.count(BEGIN) != 1 or text.count(END) != 1:
        raise ValueError(f"{page} needs the lines {BEGIN} and {END} once each; the tables stand between them")
    before, _, rest = text.partition(BEGIN)
    after = rest.partition(END)[2]
    page.write_text(f"{before}{BEGIN}\n{tables(results)}{END}{after}", encoding="utf-8")


def tables(results: Sequence[Result]) -> str:
    """All tables, and what does not hold."""
    parts = dict.fromkeys(result.part for result in results)
    texts = [TABLES[part]([r for r in results if r.part == part]) for part in TABLES if part in parts]
    failed = [f"* {r.part}, {r.name}: {_line(r.why)}" for r in results if not r.holds]
    texts.append("### What does not hold\n\n" + ("\n".join(failed) if failed else "Nothing that was tried.") + "\n")
    return "\n" + "\n".join(texts) + "\n"


def table(head: Row, rows: Sequence[Row]) -> str:
    """A table in Markdown: the first column to the left, the others to the right."""
    lines = [head, ("---", *["--:"] * (len(head) - 1)), *rows]
    return "".join(f"| {' | '.join(_cell(cell) for cell in line)} |\n" for line in lines)


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ")


def _line(why: str) -> str:
    """The first and the last line of a reason, shortened."""
    lines = [line for line in why.strip().splitlines() if line.strip()] or ["?"]
    said = lines[0] if len(lines) == 1 or not lines[0].startswith("Traceback") else lines[-1]
    return said.replace("<", "&lt;")[:300]


def _held(results: Sequence[Result]) -> list[Result]:
    return [result for result in results if result.holds]


def _count(results: Sequence[Result], name: str) -> str:
    return f"{total(results, name):,.0f}"


def _kills(results: Sequence[Result]) -> str:
    settings = dict.fromkeys(r.figures["setting"] for r in _held(results))
    rows = []
    for setting in sorted(settings):
        these = [r for r in _held(results) if r.figures["setting"] == setting]
        counts = [_count(these, name) for name in ("kills", "program", "worker", "sealed", "encoding", "compared")]
        rows.append((setting, *counts, f"{max(r.figures['longest_orphan_s'] for r in these):.1f}"))
    everything = _held(results)
    counts = [_count(everything, name) for name in ("kills", "program", "worker", "sealed", "encoding", "compared")]
    longest = max((r.figures["longest_orphan_s"] for r in everything), default=0.0)
    rows.append(("all", *counts, f"{longest:.1f}"))
    head = ("played", "kills", "program", "worker", "sealed", "while encoding", "tables equal", "longest orphan, s")
    return "### Kills\n\n" + table(head, rows)


def _inputs(results: Sequence[Result]) -> str:
    rows = []
    for family in dict.fromkeys(r.figures["family"] for r in _held(results)):
        these = [r for r in _held(results) if r.figures["family"] == family]
        counts = [_count(these, name) for name in ("inputs", "taken", "refused")]
        rows.append((family, *counts, "0", f"{max(r.figures['grown_mb'] for r in these):.0f}"))
    everything = _held(results)
    counts = [_count(everything, name) for name in ("inputs", "taken", "refused")]
    rows.append(("all", *counts, "0", f"{max((r.figures['grown_mb'] for r in everything), default=0.0):.0f}"))
    head = ("inputs", "tried", "taken", "refused", "other errors, crashes, hangs", "most memory more, MB")
    return "### Inputs\n\n" + table(head, rows)


def _soak(results: Sequence[Result]) -> str:
    names = {
        "minutes": "minutes",
        "resets": "resets",
        "frames": "frames",
        "memory_mb": "memory, MB",
        "slope_mb_per_hour": "slope, MB/h",
        "files": "open files",
        "threads": "threads",
        "children": "children",
        "shared": "shared memory",
    }
    rows = [(r.name, *(f"{r.figures[name]:,}" for name in names)) for r in _held(results)]
    return "### Soak\n\n" + table(("soak", *names.values()), rows)


def _listed(title: str, what: str) -> Callable[[Sequence[Result]], str]:
    """A table of cases with their figures in words."""

    def made(results: Sequence[Result]) -> str:
        rows = []
        for r in results:
            said = ", ".join(f"{key} {value}" for key, value in r.figures.items())
            rows.append((r.name, said, "holds" if r.holds else "**does not hold**"))
        return f"### {title}\n\n" + table((what, "figures", "equal"), rows)

    return made


TABLES: dict[str, Callable[[Sequence[Result]], str]] = {
    "kills": _kills,
    "inputs": _inputs,
    "soak": _soak,
    "sharing": _listed("Sharing", "at the same time"),
    "equality": _listed("Equal trajectories", "defender"),
    "pages": _listed("Reports in a browser", "report"),
}
