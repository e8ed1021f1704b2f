"""One grammar of names for every family of plug-ins: defenders, attacks, scenes, detectors, policies.

    name                               a name of the family
    name:option=value,option=value     the same with options
    module:Class                       a class of yours, or a function annotated to return one
    module:Class:option=value          the same with options

An option's text is read by the type that its parameter is annotated with. What is imported is held against the family
before it is called. A comma inside brackets does not end a value.
"""

from __future__ import annotations

import ast
import inspect
import math
import re
import reprlib
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from importlib import import_module
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Generic, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

T = TypeVar("T")

MAX_LENGTH = 4096
"""Characters of a whole specification; a path may be long."""

MAX_VALUE = 512
"""Characters of one option's value."""

_TRUTH = {"true": True, "yes": True, "1": True, "": True, "false": False, "no": False, "0": False}
_IDENTIFIER = re.compile(r"[^\W\d]\w*(\.[^\W\d]\w*)*")


@dataclass(frozen=True)
class Spec:
    """What a specification says: a name (or `module:Class`) and the text of its options."""

    name: str
    options: dict[str, str] = field(default_factory=dict)

    @classmethod
    def parse(cls, text: str) -> Spec:
        """Read a specification.

        Raises:
            ValueError: it is longer than `MAX_LENGTH`, a value is longer than `MAX_VALUE`, an option is named twice, or
                the text does not follow the grammar.
        """
        if len(text) > MAX_LENGTH:
            raise ValueError(f"a specification holds at most {MAX_LENGTH} characters, not {len(text)}: {text[:40]!r}…")
        name, _, rest = text.partition(":")
        attribute, _, behind = rest.partition(":")
        if attribute.isidentifier():
            name, rest = f"{name}:{attribute}", behind
        options: dict[str, str] = {}
        for part in _split(rest):
            key, equals, value = part.partition("=")
            if not (name and equals and key.isidentifier()) or key in options:
                raise ValueError(
                    f"cannot read {text!r}: write name, module:Class, or either with options, each once: "
                    "name:option=value,option=value"
                )
            if len(value) > MAX_VALUE:
                raise ValueError(f"option {key} holds at most {MAX_VALUE} characters, not {len(value)}")
            options[key] = value
        return cls(name, options)

    def without(self, names: Collection[str]) -> str:
        """The specification again, less the options of these names."""
        rest = ",".join(f"{key}={value}" for key, value in self.options.items() if key not in names)
        return f"{self.name}:{rest}" if rest else self.name

    @property
    def place(self) -> tuple[str, str] | None:
        """Module and attribute, if the name says where a class is; else None."""
        module, colon, attribute = self.name.partition(":")
        return (module, attribute) if colon else None


def _split(text: str) -> Iterable[str]:
    """The parts between commas that stand in no bracket."""
    depth, start = 0, 0
    for i, c in enumerate(text):
        depth += (c in "([{") - (c in ")]}")
        if c == "," and depth <= 0:
            yield text[start:i]
            start = i + 1
    if text[start:]:
        yield text[start:]


def nearest(word: str, known: Iterable[str]) -> str:
    """`" (did you mean 'x'?)"` for the known word that is nearest; empty if none is near."""
    close = get_close_matches(str(word)[:80], list(known), n=1)
    return f" (did you mean {close[0]!r}?)" if close else ""


class _Short(reprlib.Repr):
    """Texts, collections and numbers of any size and depth in a few characters."""

    maxlevel, maxother, maxlong = 4, 400, 400

    def repr_str(self, text: str, level: int) -> str:
        return repr(text if len(text) <= 400 else text[:400] + "…")


def shown(value: object, width: int = 80) -> str:
    """A value for an error message: its `repr` in at most so many characters, whatever it is.

    However large or deep the value, this takes little time and memory, and it never fails.
    """
    try:
        text = _Short().repr(value)
    except Exception:  # a `repr` of somebody's, or a number of more digits than Python writes
        text = f"<{type(value).__name__}>"
    return text if len(text) <= width else f"{text[: width - 1]}…"


def unknown(what: str, word: object, known: Collection[str]) -> ValueError:
    """The error for a word that is not known, with the nearest known one."""
    close = nearest(word, known) if isinstance(word, str) else ""
    return ValueError(f"unknown {what} {shown(word, 200)}{close}; known: {', '.join(known)}")


@dataclass(frozen=True, eq=False)
class Registry(Generic[T]):
    """A family of plug-ins: what its members are called, and what makes a class one of them.

    Attributes:
        family: the noun for one member, as it stands in error messages.
        entries: from a name to what makes a member, or to where that is ("module:attribute", imported when asked for).
        kind: the class or `runtime_checkable` protocol that members are instances of; or several.
        methods: the methods that a class from outside must have, in one way or another; by default it must derive from
            `kind`.
    """

    family: str
    entries: Mapping[str, Callable[..., T] | str]
    kind: Any
    methods: tuple[tuple[str, ...], ...] = ()

    def names(self) -> tuple[str, ...]:
        """The names of the family."""
        return tuple(self.entries)

    def name_of(self, member: T) -> str:
        """The name that the member's class has in the family; the class's own name if it has none."""
        cls = type(member)
        place = f"{cls.__module__}:{cls.__qualname__}"
        return next((name for name, entry in self.entries.items() if entry in (place, cls)), cls.__name__)

    def make(self, spec: str | T | Callable[..., T], /, **options: Any) -> T:
        """The member that `spec` names, built with its options; a finished member is handed back as it is.

        Args:
            spec: a name or a place with or without options, a class or function that builds a member, or a member.
            options: further options; each is checked like one in the text.

        Returns:
            A member of the family.

        Raises:
            ValueError: an unknown name or option (with the nearest known one), a value of the wrong type, options
                for a finished member, something that cannot be imported or is no member.
        """
        if isinstance(spec, str):
            parsed = Spec.parse(spec)
            factory: Callable[..., Any] = self.factory(parsed.name)
            if doubled := sorted(set(parsed.options) & set(options)):
                raise ValueError(f"option {doubled[0]!r} of {self.family} {spec!r} is given twice; drop one of them")
            return self._build(factory, parsed.name, {**parsed.options, **options})
        if isinstance(spec, self.kind) and not inspect.isclass(spec):
            if options:
                raise ValueError(f"a finished {self.family} takes no options, got {sorted(options)}; pass its class")
            return spec
        if not callable(spec):
            raise ValueError(
                f"a {self.family} is a name, an object, or what builds one; got {type(spec).__name__} {shown(spec)}"
            )
        return self._build(spec, getattr(spec, "__name__", repr(spec)), options)

    def factory(self, name: str) -> Callable[..., T]:
        """What builds the member of that name or place; imported, held against the family, not called.

        Raises:
            ValueError: an unknown name, a place that cannot be imported, or an object there that is no member's class.
        """
        known = self.entries.get(name, name)
        if not isinstance(known, str):
            return known
        module, colon, attribute = known.partition(":")
        if not colon:
            raise ValueError(f"{unknown(self.family, name, self.names())}; or module:Class of yours")
        if not _IDENTIFIER.fullmatch(module) or not _IDENTIFIER.fullmatch(attribute):
            raise ValueError(f"unknown {self.family} {name!r}: {module!r} and {attribute!r} must be Python names")
        try:
            found: Any = getattr(import_module(module), attribute)
        except (ImportError, AttributeError) as error:
            raise ValueError(
                f"no {self.family} {name!r} ({error}): name one of {', '.join(self.names())}, or a class that can be "
                "imported"
            ) from error
        if name not in self.entries and not self._builds(found):
            raise ValueError(
                f"{name!r} is no {self.family}: it must be {self._wanted}, or a function annotated to return one; "
                "nothing was called"
            )
        factory: Callable[..., T] = found
        return factory

    @property
    def _wanted(self) -> str:
        if not self.methods:
            return f"a class derived from {self.kind.__name__}"
        return f"a class with the methods {' or '.join(', '.join(one) for one in self.methods)}"

    def _builds(self, found: Any) -> bool:
        """Whether `found` is a member's class, or a function that says it returns a member."""
        if not inspect.isclass(found):
            if not inspect.isroutine(found):
                return False
            try:
                found = get_type_hints(found).get("return")
            except (TypeError, NameError, AttributeError):
                return False
        if not inspect.isclass(found):
            return False
        if self.methods:
            return any(all(hasattr(found, method) for method in one) for one in self.methods)
        return issubclass(found, self.kind)

    def _build(self, factory: Callable[..., Any], name: str, options: Mapping[str, Any]) -> T:
        made = factory(**typed_options(factory, options, f"{self.family} {name!r}"))
        if not isinstance(made, self.kind):
            raise ValueError(f"{name!r} built a {type(made).__name__}, which is no {self.family}")
        member: T = made
        return member


def typed_options(
    factory: Callable[..., Any], options: Mapping[str, Any], what: str, given: Collection[str] = ()
) -> dict[str, Any]:
    """The options as keyword arguments of `factory`: texts read by type, other values checked by it.

    Args:
        factory: a class or function with annotated parameters.
        options: from a name to a text or a value.
        what: whose options they are, for messages.
        given: parameters that the caller fills in; they are no options.

    Returns:
        Keyword arguments.

    Raises:
        ValueError: an option that `factory` has not, one that it needs and was not given, or a value of the wrong type.
    """
    try:
        parameters = inspect.signature(factory).parameters
    except ValueError:  # some builtins have none
        return dict(options)
    takes_any = any(p.kind is p.VAR_KEYWORD for p in parameters.values())
    named = (inspect.Parameter.KEYWORD_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    known = [p.name for p in parameters.values() if p.kind in named and p.name not in given]
    for key in options:
        if key not in known and not takes_any:
            raise unknown(f"option of {what}", key, known)
    needed = [n for n in known if parameters[n].default is inspect.Parameter.empty and n not in options]
    if needed:
        raise ValueError(f"{what} needs the option {needed[0]!r}")
    hints = _hints(factory)
    return {key: _value(key, value, hints.get(key, Any)) for key, value in options.items()}


def _hints(factory: Callable[..., Any]) -> dict[str, Any]:
    try:
        return get_type_hints(factory.__init__ if inspect.isclass(factory) else factory)
    except (TypeError, NameError, AttributeError):
        parameters = inspect.signature(factory).parameters.values()
        return {
            p.name: p.annotation
            for p in parameters
            if p.annotation is not p.empty and not isinstance(p.annotation, str)
        }


def checked_value(key: str, value: Any, kind: Any) -> Any:
    """`value` if it is of the kind that option `key` is annotated with; a whole float may stand for an int.

    Raises:
        ValueError: it is not; the message says what is wanted.
    """
    alternatives = get_args(kind) if get_origin(kind) in (Union, UnionType) else (kind,)
    for alternative in alternatives:
        try:
            return _checked(value, alternative)
        except (ValueError, TypeError, OverflowError):
            continue
    raise ValueError(f"{key} must be {_described(alternatives)}, not {shown(value)}{_near(value, alternatives)}")


def _near(value: Any, kinds: Iterable[Any]) -> str:
    choices = [str(choice) for kind in kinds if get_origin(kind) is Literal for choice in get_args(kind)]
    return nearest(value, choices) if isinstance(value, str) else ""


def _value(key: str, value: Any, kind: Any) -> Any:
    """The value of option `key`, which is annotated with `kind`."""
    if not isinstance(value, str):
        return checked_value(key, value, kind)
    alternatives = get_args(kind) if get_origin(kind) in (Union, UnionType) else (kind,)
    for alternative in alternatives:
        try:
            return _read(value, alternative)
        except (ValueError, TypeError, KeyError, OverflowError):
            continue
    raise ValueError(f"{key} must be {_described(alternatives)}, not {shown(value)}{_near(value, alternatives)}")


def _read(text: str, kind: Any) -> Any:
    """`text` as a value of one kind; ValueError or KeyError if it is none."""
    if kind is Any or isinstance(kind, TypeVar):
        return _literal(text)
    if kind in (None, NoneType):
        if text.lower() != "none":
            raise ValueError
        return None
    if kind is bool:
        return _TRUTH[text.lower()]
    if kind is int:
        return int(text)
    if kind is float:
        return _finite(float(text))
    if kind in (str, Path):
        return kind(text)
    origin = get_origin(kind)
    if origin is Literal:
        return next(choice for choice in get_args(kind) if str(choice) == text) if _among(text, kind) else _refuse()
    if origin in (tuple, list) or (inspect.isclass(origin) and issubclass(origin, Collection)):
        inner = (get_args(kind) or (Any,))[0]
        return tuple(_read(part.strip(), inner) for part in _split(text.strip("()[]")))
    return _refuse()


def _checked(value: Any, kind: Any) -> Any:
    """`value` if it is of one kind; numbers must be finite, a whole float is an int, a bool is no number."""
    if kind is Any or isinstance(kind, TypeVar):
        return value
    if kind in (None, NoneType):
        return None if value is None else _refuse()
    if kind in (int, float):
        return _number(value, kind)
    if get_origin(kind) is Literal:
        return value if isinstance(value, str | int) and value in get_args(kind) else _refuse()
    origin = get_origin(kind) or kind
    if origin is Callable:
        return value if callable(value) else _refuse()
    if origin is bool and isinstance(value, np.bool_):
        return bool(value)
    if origin is tuple and isinstance(value, list):
        return tuple(value)
    if inspect.isclass(origin) and not _is_of(value, origin):
        return _refuse()
    return value


def _is_of(value: Any, cls: type) -> bool:
    """Whether a value is of a class; true for protocols that cannot be asked."""
    try:
        return isinstance(value, cls)
    except TypeError:
        return True


def _number(value: Any, kind: type) -> float | int:
    """A finite float, or a whole number, also if it stands as a float; no bool, no array, no masked number."""
    axes: Any = getattr(value, "ndim", 0)
    if isinstance(value, bool | np.ma.MaskedArray) or not hasattr(value, "__float__") or axes:
        return _refuse()
    try:
        number = _finite(float(value))
    except Exception as error:  # whatever an object of others raises, it is no number
        raise ValueError from error
    if kind is float:
        return number
    return int(number) if number.is_integer() else _refuse()


def _literal(text: str) -> Any:
    """What an option without an annotation means: a Python literal, else the text itself."""
    try:
        return ast.literal_eval(text)
    except (ValueError, SyntaxError, MemoryError, RecursionError):
        return text


def _finite(number: float) -> float:
    return number if math.isfinite(number) else _refuse()


def _among(text: str, kind: Any) -> bool:
    return text in map(str, get_args(kind))


def _refuse() -> Any:
    raise ValueError


def _described(kinds: Iterable[Any]) -> str:
    """The kinds in words."""
    words = {
        int: "a whole number",
        float: "a finite number",
        bool: "true or false",
        str: "a text",
        NoneType: "none",
        Callable: "a function",
    }
    texts = []
    for kind in kinds:
        if get_origin(kind) is Literal:
            texts.append(f"one of {', '.join(map(str, get_args(kind)))}")
        else:
            texts.append(words.get(get_origin(kind) or kind, getattr(kind, "__name__", str(kind))))
    return " or ".join(texts)
