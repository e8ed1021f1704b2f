"""Pickles of others read by a small machine of our own: it knows few opcodes, and calls only what it is given.

Python's unpickler is not used. A file can ask for nothing outside `makers`, refers to no attribute, and is held to
`MAX_STEPS` opcodes. What it builds is walked once before anybody else sees it: as a tree, it has at most `MAX_NODES`
values on `MAX_DEPTH` levels. Protocols 2 to 5 are read. Source of the opcodes: Python's `pickletools`.
"""

from __future__ import annotations

import pickletools
from collections.abc import Callable, Mapping
from io import BytesIO
from typing import Any

import numpy as np

MAX_STEPS = 200_000
"""Opcodes of a file."""

MAX_NODES = 200_000
"""Values of what a file holds, shared ones counted each time they are met."""

MAX_DEPTH = 24
"""Levels of lists, tuples and dictionaries."""

_VALUES = {
    *("BININT", "BININT1", "BININT2", "LONG1", "BINFLOAT", "BINSTRING", "SHORT_BINSTRING"),
    *("BINUNICODE", "SHORT_BINUNICODE", "BINUNICODE8", "BINBYTES", "SHORT_BINBYTES", "BINBYTES8", "BYTEARRAY8"),
}
_CONSTANTS: dict[str, Any] = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False}
_ATOMS = (type(None), bool, int, float, str, bytes)


class Refused(ValueError):
    """A pickle that asks for more than it may."""


class Draft:
    """A value that a later opcode completes, with its state."""

    def build(self, state: Any) -> Any:
        """The finished value; ValueError or TypeError if the state does not fit."""
        raise NotImplementedError


_MARK = object()


def run(
    data: bytes,
    makers: Mapping[str, Any],
    leaves: tuple[type, ...] = (),
    persistent: Callable[[Any], Any] | None = None,
) -> Any:
    """What a pickle holds.

    Args:
        data: the pickle.
        makers: by "module.name", what stands for the functions and classes that it may name.
        leaves: the types that makers make beside arrays and numpy's numbers, as they may stand in the result.
        persistent: from a persistent id to what it stands for; without it, such ids are refused.

    Returns:
        Lists, tuples, dictionaries (their keys texts and numbers), arrays, plain values and `leaves`.

    Raises:
        ValueError: the pickle is broken, exceeds a bound, or names what is not among `makers`.
    """
    machine = _Machine(makers, persistent)
    steps = 0
    try:
        for opcode, argument, _ in pickletools.genops(BytesIO(data)):
            steps += 1
            if steps > MAX_STEPS:
                raise Refused(f"it has more than {MAX_STEPS} opcodes")
            if opcode.name == "STOP":
                break
            machine.step(opcode.name, argument)
        (result,) = machine.stack
    except Refused:
        raise
    except (ValueError, TypeError, KeyError, IndexError, AttributeError, OverflowError) as error:
        raise ValueError(f"it is no pickle that can be read ({str(error)[:200]})") from error
    except RecursionError as error:  # somebody looks into a value before it is known to be shallow
        raise Refused("it is nested too deeply") from error
    _check(result, leaves)
    return result


class _Machine:
    """The stack and the memory of a pickle that is read."""

    def __init__(self, makers: Mapping[str, Any], persistent: Callable[[Any], Any] | None) -> None:
        self.stack: list[Any] = []
        self._memory: dict[int, Any] = {}
        self._kept: dict[int, list[int]] = {}  # of the drafts in memory, by id: where they are kept
        self._makers, self._persistent = makers, persistent

    def step(self, name: str, argument: Any) -> None:
        if name in _VALUES:
            self.stack.append(bytes(argument) if isinstance(argument, bytearray) else argument)
        elif name in _CONSTANTS:
            self.stack.append(_CONSTANTS[name])
        elif (method := getattr(self, f"_op_{name.lower()}", None)) is not None:
            method(argument)
        elif name not in ("PROTO", "FRAME"):
            raise Refused(f"it uses the opcode {name}; only arrays and plain containers are read")

    # -- containers ---------------------------------------------------------------------------------------------------

    def _op_mark(self, _: Any) -> None:
        self.stack.append(_MARK)

    def _op_empty_tuple(self, _: Any) -> None:
        self.stack.append(())

    def _op_empty_list(self, _: Any) -> None:
        self.stack.append([])

    def _op_empty_dict(self, _: Any) -> None:
        self.stack.append({})

    def _op_tuple(self, _: Any) -> None:
        self.stack.append(tuple(self._since_mark()))

    def _op_tuple1(self, _: Any) -> None:
        self.stack.append(tuple(self._pop(1)))

    def _op_tuple2(self, _: Any) -> None:
        self.stack.append(tuple(self._pop(2)))

    def _op_tuple3(self, _: Any) -> None:
        self.stack.append(tuple(self._pop(3)))

    def _op_append(self, _: Any) -> None:
        (value,) = self._pop(1)
        self._top(list).append(value)

    def _op_appends(self, _: Any) -> None:
        values = self._since_mark()
        self._top(list).extend(values)

    def _op_setitem(self, _: Any) -> None:
        self._set(self._pop(2))

    def _op_setitems(self, _: Any) -> None:
        self._set(self._since_mark())

    def _set(self, pairs: list[Any]) -> None:
        target = self._top(dict)
        for key, value in zip(pairs[::2], pairs[1::2], strict=True):
            if type(key) not in _ATOMS:
                raise Refused(f"a dictionary's key is a {type(key).__name__}; texts and numbers are read")
            target[key] = value

    # -- memory -------------------------------------------------------------------------------------------------------

    def _op_memoize(self, _: Any) -> None:
        self._op_binput(len(self._memory))

    def _op_binput(self, place: int) -> None:
        value = self.stack[-1]
        self._memory[place] = value
        if isinstance(value, Draft):
            self._kept.setdefault(id(value), []).append(place)

    _op_long_binput = _op_binput

    def _op_binget(self, place: int) -> None:
        self.stack.append(self._memory[place])

    _op_long_binget = _op_binget

    # -- what is made -------------------------------------------------------------------------------------------------

    def _op_global(self, words: str) -> None:
        self._name(*words.split(" ", 1))

    def _op_stack_global(self, _: Any) -> None:
        self._name(*self._pop(2))

    def _name(self, module: str, name: str) -> None:
        place = f"{module}.{name}"
        if place not in self._makers:
            raise Refused(f"it asks for {place[:80]}; only arrays and plain containers are read")
        self.stack.append(self._makers[place])

    def _op_reduce(self, _: Any) -> None:
        maker, arguments = self._pop(2)
        if not callable(maker) or not isinstance(arguments, tuple):
            raise Refused("it calls what is no maker of arrays")
        self.stack.append(maker(*arguments))

    def _op_build(self, _: Any) -> None:
        draft, state = self._pop(2)
        if type(draft) is dict:  # attributes of an ordered dictionary: they are left out
            self.stack.append(draft)
            return
        if not isinstance(draft, Draft):
            raise Refused(f"it sets the state of a {type(draft).__name__}")
        value = draft.build(state)
        self.stack.append(value)
        for place in self._kept.pop(id(draft), []):
            self._memory[place] = value

    def _op_binpersid(self, _: Any) -> None:
        (key,) = self._pop(1)
        if self._persistent is None:
            raise Refused("it refers to objects outside the file")
        self.stack.append(self._persistent(key))

    # -- the stack ----------------------------------------------------------------------------------------------------

    def _pop(self, count: int) -> list[Any]:
        values = self.stack[-count:]
        if len(values) < count or any(value is _MARK for value in values):
            raise ValueError("its stack is empty")
        del self.stack[-count:]
        return values

    def _since_mark(self) -> list[Any]:
        place = len(self.stack) - 1
        while place >= 0 and self.stack[place] is not _MARK:
            place -= 1
        if place < 0:
            raise ValueError("a mark is missing")
        values = self.stack[place + 1 :]
        del self.stack[place:]
        return values

    def _top(self, kind: type) -> Any:
        if type(self.stack[-1]) is not kind:
            raise Refused(f"it fills a {type(self.stack[-1]).__name__} as if it were a {kind.__name__}")
        return self.stack[-1]


def _check(value: Any, leaves: tuple[type, ...]) -> None:
    """ValueError for what is too large, too deep, circular, unfinished or of another type."""
    todo, nodes = [(value, 0)], 0
    while todo:
        value, depth = todo.pop()
        nodes += 1
        if nodes > MAX_NODES or depth > MAX_DEPTH:
            raise Refused(f"it holds more than {MAX_NODES} values, or is nested deeper than {MAX_DEPTH} levels")
        if type(value) in (list, tuple):
            todo += [(item, depth + 1) for item in value]
        elif type(value) is dict:
            todo += [(item, depth + 1) for item in value.values()]
        elif isinstance(value, np.ndarray) and value.dtype.kind == "O":
            todo += [(item, depth + 1) for item in value.flat]
        elif type(value) not in _ATOMS and not isinstance(value, (np.ndarray, np.generic, *leaves)):
            raise Refused(f"it holds a {type(value).__name__}; only arrays and plain containers are read")
