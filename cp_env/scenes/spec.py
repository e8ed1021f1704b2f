"""Scenes named by a string: `town/test`, or `kind:path?option=value&option=value`."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from types import NoneType, UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

_TRUTH = {"true": True, "yes": True, "1": True, "": True, "false": False, "no": False, "0": False}


@dataclass(frozen=True)
class Spec:
    """What `kind:path?option=value&…` says."""

    kind: str
    path: str
    options: dict[str, str]

    @classmethod
    def parse(cls, text: str) -> Spec:
        """An option without `=value` means true, a path may hold `:`; ValueError if kind or path is missing."""
        kind, _, rest = text.partition(":")
        path, _, query = rest.partition("?")
        if not kind or not path:
            raise ValueError(f"scenes {text!r} must read kind:path or kind:path?option=value&option=value")
        pairs = [part.partition("=") for part in query.split("&") if part]
        return cls(kind, path, {key: value for key, _, value in pairs})

    def open(self, factory: Callable[..., Any]) -> Any:
        """`factory(path, **options)`, each option converted to the type its keyword is annotated with.

        Raises:
            ValueError: an option that `factory` has not, or a value that is not of its type.
        """
        keywords = [p.name for p in inspect.signature(factory).parameters.values() if p.kind is p.KEYWORD_ONLY]
        unknown = sorted(set(self.options) - set(keywords))
        if unknown:
            raise ValueError(f"unknown option {unknown[0]!r} of {self.kind} scenes; known: {', '.join(keywords)}")
        hints = get_type_hints(factory.__init__ if inspect.isclass(factory) else factory)
        return factory(self.path, **{key: _convert(key, text, hints[key]) for key, text in self.options.items()})


def _convert(key: str, text: str, kind: Any) -> Any:
    """`text` as a `bool`, `int`, `float`, `str`, `Path`, one of these or None, or a tuple of them (with commas)."""
    if get_origin(kind) in (Union, UnionType):
        kind = next(option for option in get_args(kind) if option is not NoneType)
    if get_origin(kind) is tuple:
        return tuple(_convert(key, part, get_args(kind)[0]) for part in text.split(",") if part)
    try:
        return _TRUTH[text.lower()] if kind is bool else kind(text)
    except (KeyError, ValueError) as error:
        raise ValueError(f"option {key} must be {kind.__name__}: got {text!r}") from error
