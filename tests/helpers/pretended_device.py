"""A pretended accelerator: what would fail on a device of its own fails here, on a machine that has none.

Tensors "on the device" are real ones on the CPU behind a wrapper that says it is elsewhere. As on an accelerator, an
operation on tensors of two places raises (numbers without axes may come from the CPU), numpy cannot read them, and only
`.cpu()`, `.item()` and their like bring them back. The pretended place is torch's "meta", which needs no hardware; so
`device="meta"`, in `with pretended():`.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Any
from unittest import mock

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_flatten, tree_map

from cp_env.world import transmission

AWAY = torch.device("meta")


class Away(Tensor):
    """A tensor that says it is on the device; `here` is where its numbers are."""

    here: Tensor

    @staticmethod
    def __new__(cls, here: Tensor) -> Away:
        made = Tensor._make_wrapper_subclass(
            cls,
            here.shape,
            strides=here.stride(),
            storage_offset=here.storage_offset(),
            dtype=here.dtype,
            device=AWAY,
            requires_grad=here.requires_grad,
        )
        made.here = here
        return made

    def __repr__(self, *, tensor_contents: object = None) -> str:
        return f"Away({self.here!r})"

    def tolist(self) -> Any:
        return self.here.tolist()

    @classmethod
    def __torch_dispatch__(cls, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        return dispatched(func, args, kwargs or {})


class Pretended(TorchDispatchMode):
    """Catches what makes tensors on the device from nothing."""

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        return dispatched(func, args, kwargs or {})


class FromNumbers(TorchFunctionMode):
    """Catches what makes tensors of Python's numbers, which does not reach the dispatcher."""

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = kwargs or {}
        of_numbers = func in (torch.tensor, torch.as_tensor) and not isinstance(args[0], Tensor)
        if of_numbers and kwargs.get("device") is not None and torch.device(kwargs["device"]) == AWAY:
            return torch.tensor(*args, **{**kwargs, "device": "cpu"}).to(AWAY)
        if func is Tensor.new_tensor and isinstance(args[0], Away):
            return args[0].here.new_tensor(*args[1:], **kwargs).to(AWAY)
        return func(*args, **kwargs)


def dispatched(func: Any, args: Any, kwargs: dict[str, Any]) -> Any:
    """The operation, done on the CPU; its result is on the device if its operands or its `device` say so."""
    flat, _ = tree_flatten((args, kwargs))
    away = any(isinstance(one, Away) for one in flat)
    asked = kwargs.get("device")
    if func is torch.ops.aten._local_scalar_dense.default:
        return func(*tree_map(brought, args))
    moves = func in (torch.ops.aten._to_copy.default, torch.ops.aten.copy_.default)
    if away and not moves:
        strangers = [one for one in flat if isinstance(one, Tensor) and not isinstance(one, Away) and one.dim()]
        indexing = func in (
            torch.ops.aten.index.Tensor,
            torch.ops.aten.index_put_.default,
            torch.ops.aten.index_put.default,
        )
        if strangers and not indexing:
            raise RuntimeError(
                f"{func}: tensors on the device and on the CPU meet: {[tuple(s.shape) for s in strangers]}"
            )
    there = away if asked is None else torch.device(asked) == AWAY
    kwargs = {**kwargs, "device": torch.device("cpu")} if asked is not None else kwargs
    result = func(*tree_map(brought, args), **tree_map(brought, kwargs))
    if func is torch.ops.aten.copy_.default:
        return args[0]
    if _returns_its_first(func) and isinstance(args[0] if args else None, Away):
        return args[0]
    return tree_map(lambda one: Away(one) if there and isinstance(one, Tensor) else one, result)


def _returns_its_first(func: Any) -> bool:
    """Whether it changes its first operand and gives that back. (Batch normalisation changes others.)"""
    schema = func._schema
    alias = schema.arguments[0].alias_info if schema.is_mutable and schema.arguments else None
    return alias is not None and alias.is_write


def brought(one: Any) -> Any:
    return one.here if isinstance(one, Away) else one


@contextmanager
def pretended() -> Iterator[None]:
    """`device="meta"` works, and is a place of its own. Inference mode, which makes no wrappers, is `no_grad` here."""

    def inference_mode(mode: bool = True) -> AbstractContextManager[Any]:
        return torch.no_grad() if mode else nullcontext()

    plain = mock.patch.object(transmission, "PLAIN", (*transmission.PLAIN, Away))  # a wrapper here, plain on a device
    with mock.patch.object(torch, "inference_mode", inference_mode), plain, Pretended(), FromNumbers():
        yield
