"""Values as bytes and back, and digests of these: dataclasses, arrays, numbers, texts and containers.

Only data is stored, and nothing of a file is run: a class is built only if the reader names it.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from hashlib import blake2b
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

DIGEST_BYTES = 16
"""Size of a digest: that two of 2^32 values share one has the probability 1e-20."""
_LENGTH = struct.Struct("<Q")
_NUMBERS = "biufc"
"""Kinds of numpy's types that are plain bits."""


class UnpackError(Exception):
    """Bytes are not what `pack` wrote."""


def pack(value: object) -> bytes:
    """Return a value as bytes. Raises ``TypeError`` for a type that is not plain data."""
    return b"".join(_parts(value))


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
    """Return a digest of the bytes that `pack` gives. Raises ``TypeError`` as it does."""
    found = blake2b(digest_size=DIGEST_BYTES)
    for part in _parts(value):
        found.update(part)
    return found.digest()


def _parts(value: object) -> Iterator[bytes]:
    """Yield the length of the tree, the tree, and each array."""
    arrays: list[Array] = []
    tree = json.dumps(_node(value, arrays), separators=(",", ":")).encode()
    yield _LENGTH.pack(len(tree))
    yield tree
    for array in arrays:
        yield array.tobytes("A")


def _node(value: Any, arrays: list[Array]) -> Any:
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
    # Those of a dataclass, or of a NamedTuple.
    names = [each.name for each in fields(value)] if is_dataclass(kind) else getattr(kind, "_fields", None)
    if names is not None:
        return {"class": [kind.__name__, {name: _node(getattr(value, name), arrays) for name in names}]}
    raise TypeError(f"{kind.__name__} is no plain data")


def _array_node(array: Array, is_scalar: bool, arrays: list[Array]) -> Any:
    if array.dtype.kind not in _NUMBERS:
        raise TypeError(f"an array of {array.dtype} is no plain data")
    # The layout in memory decides in which order a library adds up.
    order = "F" if array.flags.f_contiguous and not array.flags.c_contiguous else "C"
    arrays.append(array)
    return {"scalar" if is_scalar else "array": [array.dtype.str, list(array.shape), order]}


class _Reader:
    """Reads a tree; the arrays follow in its order."""

    def __init__(self, packed: bytes, begin: int, classes: Mapping[str, type]) -> None:
        self._packed, self._at, self._classes = packed, begin, classes

    def value(self, node: Any) -> Any:
        if not isinstance(node, dict):
            return node
        ((kind, payload),) = node.items()
        if kind in ("list", "tuple"):
            items = [self.value(each) for each in payload]
            return items if kind == "list" else tuple(items)
        if kind == "dict":
            return {self.value(k): self.value(v) for k, v in payload}
        if kind == "bytes":
            return bytes.fromhex(payload)
        if kind in ("array", "scalar"):
            array = self._array(*payload)
            return array if kind == "array" else array[()]
        name, content = payload
        if kind == "enum":
            return self._classes[name][content]  # type: ignore[index]  # an Enum's class
        if kind != "class":
            raise ValueError(f"{kind} is unknown")
        return self._classes[name](**{field: self.value(each) for field, each in content.items()})

    def _array(self, kind: str, shape: list[int], order: str) -> Array:
        dtype = np.dtype(kind)
        if dtype.kind not in _NUMBERS:
            raise ValueError(f"an array of {dtype}")
        count = int(np.prod(shape, dtype=np.int64))
        flat = np.frombuffer(self._packed, dtype, count, self._at) if count else np.empty(0, dtype)
        self._at += count * dtype.itemsize
        return flat.reshape(shape, order="F" if order == "F" else "C").copy(order="K")
