"""Protobuf messages by the declaration that an MCAP file holds, as dictionaries of their fields.

The declaration, a ``FileDescriptorSet``, is itself such a message, whose few fields that count are known.
Source: protobuf.dev, "Encoding"; ``google/protobuf/descriptor.proto``.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5
_REPEATED = 3
"""``FieldDescriptorProto.label`` of a repeated field."""
_DOUBLE, _FLOAT, _STRING, _MESSAGE, _BYTES_TYPE = 1, 2, 9, 11, 12
_FIXED: dict[int, str] = {1: "<d", 2: "<f", 6: "<Q", 7: "<I", 15: "<i", 16: "<q"}
"""Type of a field -> format of its fixed bytes."""
_SIGNED = (3, 5)
_ZIGZAG = (17, 18)
_BOOL = 8
_MAX_DEPTH = 16


@dataclass(frozen=True)
class _Field:
    name: str
    kind: int
    repeated: bool
    message: str
    """Full name of the type of a message."""

    @property
    def default(self) -> Any:
        if self.repeated:
            return []
        return {_STRING: "", _BYTES_TYPE: b"", _MESSAGE: None}.get(self.kind, 0)


class ProtobufTypes:
    """Types of messages. Raises ``ValueError`` for a damaged declaration."""

    def __init__(self, descriptor_set: bytes) -> None:
        self._types: dict[str, dict[int, _Field]] = {}
        for number, file in _fields(descriptor_set):
            if number == 1:
                parts = list(_fields(file))
                package = next((bytes(value).decode() for n, value in parts if n == 2), "")
                for n, value in parts:
                    if n == 4:
                        self._declare(f".{package}" if package else "", value, 0)

    def _declare(self, scope: str, descriptor: bytes, depth: int) -> None:
        if depth > _MAX_DEPTH:
            raise ValueError("types are nested too deeply")
        parts = list(_fields(descriptor))
        name = f"{scope}.{next(bytes(v).decode() for n, v in parts if n == 1)}"
        self._types[name] = dict(_declared(value) for n, value in parts if n == 2)
        for n, value in parts:
            if n == 3:
                self._declare(name, value, depth + 1)

    def decode(self, name: str, data: bytes, depth: int = 0) -> dict[str, Any]:
        """Return the fields of a message; missing ones have their defaults. Raises ``ValueError``."""
        types = self._types.get("." + name.lstrip("."))
        if types is None or depth > _MAX_DEPTH:
            raise ValueError(f"the type {name[:60]} is not declared")
        found = {each.name: each.default for each in types.values()}
        for number, value in _fields(data):
            each = types.get(number)
            if each is None:
                continue
            values = self._values(each, value, depth)
            if each.repeated:
                found[each.name] = [*found[each.name], *values]
            elif values:
                found[each.name] = values[-1]
        return found

    def _values(self, field: _Field, value: int | bytes, depth: int) -> list[Any]:
        if field.kind == _MESSAGE:
            return [self.decode(field.message, _as_bytes(value), depth + 1)]
        if field.kind == _BYTES_TYPE:
            return [_as_bytes(value)]
        if field.kind == _STRING:
            return [_as_bytes(value).decode("utf-8", errors="replace")]
        if (layout := _FIXED.get(field.kind)) is not None:
            data = _as_bytes(value)
            if len(data) % struct.calcsize(layout):
                raise ValueError("a field has another length than its type")
            return [number for (number,) in struct.iter_unpack(layout, data)]
        raw = list(_varints(value)) if isinstance(value, bytes) else [value]
        return [_number(field.kind, each) for each in raw]


def _declared(descriptor: bytes) -> tuple[int, _Field]:
    parts = dict(_fields(descriptor))
    if not isinstance(parts.get(3), int) or not isinstance(parts.get(5), int):
        raise ValueError("a field is not declared")
    name, message = (_as_bytes(parts.get(n, b"")).decode() for n in (1, 6))
    return parts[3], _Field(name, parts[5], parts.get(4) == _REPEATED, message)


def _fields(data: int | bytes) -> Iterator[tuple[int, Any]]:
    """Yield number and value of each field: an integer, or bytes for fixed and delimited values."""
    data, at = _as_bytes(data), 0
    while at < len(data):
        key, at = _varint(data, at)
        kind = key & 7
        if kind == _VARINT:
            value, at = _varint(data, at)
            yield key >> 3, value
            continue
        if kind == _BYTES:
            size, at = _varint(data, at)
        elif kind in (_FIXED64, _FIXED32):
            size = 8 if kind == _FIXED64 else 4
        else:
            raise ValueError("a field has an unknown encoding")
        if at + size > len(data):
            raise ValueError("a field leads out of its message")
        yield key >> 3, data[at : at + size]
        at += size


def _varint(data: bytes, at: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, 70, 7):
        if at >= len(data):
            break
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
    raise ValueError("a number has no end")


def _varints(data: bytes) -> Iterator[int]:
    at = 0
    while at < len(data):
        value, at = _varint(data, at)
        yield value


def _number(kind: int, value: int) -> int | bool:
    if kind in _SIGNED:
        value &= 2**64 - 1
        return value - 2**64 if value >= 2**63 else value
    if kind in _ZIGZAG:
        return (value >> 1) ^ -(value & 1)
    return bool(value) if kind == _BOOL else value


def _as_bytes(value: int | bytes) -> bytes:
    if isinstance(value, int):
        raise ValueError("a field has another encoding than its type")
    return value
