"""A mutant: one mistake that somebody could make, and the tests that are to catch it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Mutant:
    """A replacement of text in one file of the tree.

    Attributes:
        name: a few words with hyphens that say what is wrong.
        file: path from the root of the tree.
        old: text that occurs exactly once in the file.
        new: the text in its place.
        tests: paths, or node ids of pytest, of which at least one must fail.
    """

    name: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]

    def applied(self, text: str) -> str:
        """The file's text with the mistake in it. ValueError unless `old` occurs exactly once."""
        if (count := text.count(self.old)) != 1:
            raise ValueError(f"mutant {self.name}: its text occurs {count} times in {self.file}, not once")
        return text.replace(self.old, self.new)
