"""Scenes with a path, named by a string: `kind:path?option=value&option=value`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from defenders.registry import MAX_LENGTH, typed_options


@dataclass(frozen=True)
class PathSpec:
    """What `kind:path?option=value&…` says."""

    kind: str
    path: str
    options: dict[str, str]

    @classmethod
    def parse(cls, text: str) -> PathSpec:
        """Read it; an option without `=value` means true, and a path may hold `:`.

        Raises:
            ValueError: kind or path is missing, an option stands twice, or the text is too long.
        """
        if len(text) > MAX_LENGTH:
            raise ValueError(f"scenes are named by at most {MAX_LENGTH} characters, not {len(text)}: {text[:40]!r}…")
        kind, _, rest = text.partition(":")
        path, _, query = rest.partition("?")
        if not kind or not path:
            raise ValueError(f"scenes {text!r} must read kind:path or kind:path?option=value&option=value")
        pairs = [part.partition("=") for part in query.split("&") if part]
        options = {key: value for key, _, value in pairs}
        if len(options) != len(pairs):
            raise ValueError(f"scenes {text!r} name an option twice")
        return cls(kind, path, options)

    def open(self, factory: Callable[..., Any]) -> Any:
        """`factory(path, **options)`, each option read by the type that its keyword is annotated with.

        Raises:
            ValueError: an option that `factory` has not, or a value that is not of its type.
        """
        return factory(self.path, **typed_options(factory, self.options, f"{self.kind} scenes", given=("path",)))
