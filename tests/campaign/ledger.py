"""The results of a campaign in a file, line by line: a campaign that was killed goes on with the case in work."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path

from tests.campaign.case import Result

PACKAGES = ("cp_env", "defenders", "agents")
SUFFIXES = (".py", ".json", ".safetensors", ".npz")


def code_digest(root: Path) -> str:
    """A hash of everything in the packages that results can depend on."""
    digest = hashlib.sha256()
    for package in PACKAGES:
        for file in sorted((root / package).rglob("*")):
            if file.suffix in SUFFIXES:
                digest.update(f"{file.relative_to(root)}\0".encode() + file.read_bytes())
    return digest.hexdigest()[:12]


class Ledger:
    """Results by part and case; of equals the last counts.

    Args:
        file: where they are kept; a line that was cut off is left out.
    """

    def __init__(self, file: Path) -> None:
        self.file = file
        self.results: dict[tuple[str, str], Result] = {}
        for line in file.read_text(encoding="utf-8").splitlines() if file.exists() else ():
            try:
                result = Result(**json.loads(line))
            except (json.JSONDecodeError, TypeError):
                continue
            self.results[result.part, result.name] = result

    def add(self, result: Result) -> None:
        """Keep a result."""
        self.file.parent.mkdir(parents=True, exist_ok=True)
        torn = self.file.exists() and not self.file.read_bytes().endswith(b"\n")
        with self.file.open("a", encoding="utf-8") as lines:
            lines.write("\n" * torn + json.dumps(asdict(result)) + "\n")
        self.results[result.part, result.name] = result

    def known(self, part: str, name: str, code: str) -> Result | None:
        """The result of a case, if it was tried on that code and its claim held."""
        result = self.results.get((part, name))
        return result if result is not None and result.holds and result.code == code else None

    def of(self, part: str, code: str) -> list[Result]:
        """All results of a part on that code."""
        return [result for result in self.results.values() if result.part == part and result.code == code]

    def codes(self) -> tuple[str, ...]:
        """The digests of all code that was tried, the last one at the end."""
        return tuple(dict.fromkeys(result.code for result in self.results.values()))


def total(results: Iterable[Result], name: str) -> float:
    """The sum of a figure over those results that have it."""
    return sum(result.figures.get(name, 0) for result in results)
