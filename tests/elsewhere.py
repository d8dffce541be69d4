"""A stand-in for a GPU: tensors that say they are on another device (`meta`), their numbers in tensors of the CPU.

Under `Elsewhere()` what is made on that device or brought there lives there. As on a GPU, an operation on tensors of both
devices fails, and so does taking numbers from there that were not brought back; gradients flow both ways.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_map_only

DEVICE = torch.device("meta")
CPU = torch.device("cpu")


class There(Tensor):
    """A tensor of that device."""

    numbers: Tensor

    @staticmethod
    def __new__(cls, numbers: Tensor) -> There:
        shape = {"strides": numbers.stride(), "storage_offset": numbers.storage_offset()}
        tensor = Tensor._make_wrapper_subclass(cls, numbers.shape, dtype=numbers.dtype, device=DEVICE, **shape)
        tensor.numbers = numbers
        return tensor

    @classmethod
    def __torch_dispatch__(cls, operation, types, arguments=(), named=None):
        return run(operation, arguments, named or {})


class Elsewhere(TorchDispatchMode):
    """The machine that has the device."""

    def __torch_dispatch__(self, operation, types, arguments=(), named=None):
        return run(operation, arguments, named or {})


def run(operation: Any, arguments: tuple[Any, ...], named: dict[str, Any]) -> Any:
    """One operation on the numbers, its answer on the device where it belongs."""
    tensors = list(tensors_of((*arguments, *named.values())))
    there = any(isinstance(tensor, There) for tensor in tensors)
    device = named.get("device")
    if not there and (device is None or torch.device(device) != DEVICE):
        return operation(*arguments, **named)
    moves = operation in (torch.ops.aten._to_copy.default, torch.ops.aten.copy_.default)
    here = [tuple(tensor.shape) for tensor in tensors if tensor.dim() and not isinstance(tensor, There)]
    if there and here and not moves:
        raise RuntimeError(f"{operation}: tensors of two devices, of the CPU {here}")
    given = named if device is None else {**named, "device": CPU}
    inner = tree_map_only(There, lambda tensor: tensor.numbers, (arguments, given))
    answer = operation(*inner[0], **inner[1])
    if operation._schema.name.endswith("_"):
        assert arguments[0].shape == answer.shape, f"{operation}: the stand-in's shapes stay as they are"
        return arguments[0]
    if device is not None:
        there = torch.device(device) == DEVICE
    return tree_map_only(Tensor, There, answer) if there else answer


def tensors_of(values: Iterable[Any]) -> Iterator[Tensor]:
    """In order, those of lists as well."""
    for value in values:
        if isinstance(value, Tensor):
            yield value
        elif isinstance(value, list | tuple):
            yield from tensors_of(value)
