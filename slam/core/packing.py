"""Values as bytes and back, and digests: of dataclasses, arrays, numbers, texts and containers of them.

Only data is stored, and nothing of a file is run: a class is built only if the reader names it.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from hashlib import blake2b
from typing import Any, Literal

import numpy as np

DIGEST_BYTES = 16
"""Size of a digest: that two of 2^32 values share one has the probability 1e-20."""
_LENGTH = struct.Struct("<Q")
_NUMBERS = "biufc"
"""Kinds of numpy's types that are plain bits."""


class UnpackError(Exception):
    """Bytes are not what `pack` wrote."""


def pack(value: object) -> bytes:
    """Return a value as bytes. Raises ``TypeError`` for a type that is not plain data."""
    arrays: list[bytes] = []
    tree = json.dumps(_node(value, arrays), separators=(",", ":")).encode()
    return b"".join([_LENGTH.pack(len(tree)), tree, *arrays])


def unpack(packed: bytes, classes: Iterable[type] = ()) -> Any:
    """Return the value whose bytes `pack` gave, bit for bit; ``classes`` are those that it may hold.

    Raises ``UnpackError`` for other bytes.
    """
    try:
        (length,) = _LENGTH.unpack_from(packed)
        tree = json.loads(packed[_LENGTH.size : _LENGTH.size + length])
        return _Reader(packed, _LENGTH.size + length, {each.__name__: each for each in classes}).value(tree)
    except (struct.error, ValueError, KeyError, TypeError, IndexError, RecursionError, AttributeError) as why:
        raise UnpackError(f"{type(why).__name__}: {why}") from None


def digest_of(value: object) -> bytes:
    """Return a digest of a value: values of equal types and bits have equal ones.

    Raises ``TypeError`` for a type that is not data, such as a function.
    """
    found = blake2b(digest_size=DIGEST_BYTES)
    _feed(found, value)
    return found.digest()


def _node(value: Any, arrays: list[bytes]) -> Any:
    kind = type(value)
    if value is None or kind in (bool, int, float, str):
        return value
    if kind is np.ndarray or isinstance(value, np.generic):
        return _array_node(np.asarray(value), isinstance(value, np.generic), arrays)
    if kind in (list, tuple):
        return {kind.__name__: [_node(each, arrays) for each in value]}
    if kind is dict:
        return {"dict": [[_node(k, arrays), _node(v, arrays)] for k, v in value.items()]}
    if kind is bytes:
        return {"bytes": value.hex()}
    if isinstance(value, Enum):
        return {"enum": [kind.__name__, value.name]}
    if is_dataclass(kind):
        held = {each.name: _node(getattr(value, each.name), arrays) for each in fields(value)}
        return {"class": [kind.__name__, held]}
    raise TypeError(f"{kind.__name__} is no plain data")


def _array_node(array: np.ndarray[Any, Any], is_scalar: bool, arrays: list[bytes]) -> Any:
    if array.dtype.kind not in _NUMBERS:
        raise TypeError(f"an array of {array.dtype} is no plain data")
    # The layout in memory decides in which order a library adds up.
    order: Literal["C", "F"] = "F" if array.flags.f_contiguous and not array.flags.c_contiguous else "C"
    arrays.append(array.tobytes(order))
    return {"scalar" if is_scalar else "array": [array.dtype.str, list(array.shape), order]}


class _Reader:
    """Reads a tree; the arrays follow in its order."""

    def __init__(self, packed: bytes, begin: int, classes: Mapping[str, type]) -> None:
        self._packed, self._at, self._classes = packed, begin, classes

    def value(self, node: Any) -> Any:
        if not isinstance(node, dict):
            return node
        ((kind, held),) = node.items()
        if kind in ("list", "tuple"):
            items = [self.value(each) for each in held]
            return items if kind == "list" else tuple(items)
        if kind == "dict":
            return {self.value(k): self.value(v) for k, v in held}
        if kind == "bytes":
            return bytes.fromhex(held)
        if kind in ("array", "scalar"):
            array = self._array(*held)
            return array if kind == "array" else array[()]
        name, content = held
        if kind == "enum":
            return self._classes[name][content]  # type: ignore[index]  # an Enum's class
        if kind != "class":
            raise ValueError(f"{kind} is unknown")
        return self._classes[name](**{field: self.value(each) for field, each in content.items()})

    def _array(self, kind: str, shape: list[int], order: str) -> np.ndarray[Any, Any]:
        dtype = np.dtype(kind)
        if dtype.kind not in _NUMBERS:
            raise ValueError(f"an array of {dtype}")
        count = int(np.prod(shape, dtype=np.int64))
        flat = np.frombuffer(self._packed, dtype, count, self._at) if count else np.empty(0, dtype)
        self._at += count * dtype.itemsize
        return flat.reshape(shape, order="F" if order == "F" else "C").copy(order="K")


def _feed(found: Any, value: Any) -> None:
    """Add a value to a digest, each part with its type and length so that parts cannot be confused."""
    kind = type(value)
    found.update(f"<{kind.__name__}>".encode())
    if isinstance(value, Enum):
        found.update(value.name.encode())
    elif value is None or isinstance(value, bool | int | float):
        found.update(repr(value).encode())
    elif isinstance(value, str | bytes):
        raw = value.encode("utf-8", "surrogatepass") if isinstance(value, str) else value
        found.update(_LENGTH.pack(len(raw)) + raw)
    elif isinstance(value, np.ndarray | np.generic):
        array = np.asarray(value)
        if array.dtype.kind not in _NUMBERS:
            raise TypeError(f"an array of {array.dtype} has no digest")
        found.update(f"{array.dtype.str}{array.shape}".encode())
        found.update(array.tobytes())
    elif isinstance(value, tuple | list | Mapping):
        parts = value.items() if isinstance(value, Mapping) else value
        found.update(_LENGTH.pack(len(value)))
        for each in parts:
            _feed(found, each)
    elif is_dataclass(kind):
        for each in fields(value):
            found.update(each.name.encode())
            _feed(found, getattr(value, each.name))
    else:
        raise TypeError(f"{kind.__name__} has no digest")
