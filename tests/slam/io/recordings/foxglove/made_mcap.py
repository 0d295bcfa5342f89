"""Small MCAP files and protobuf messages, written byte by byte."""

from __future__ import annotations

import json
import struct
import zlib
from pathlib import Path
from typing import Any

DOUBLE, STRING, MESSAGE, BYTES, FIXED32, INT64, INT32, UINT32 = 1, 9, 11, 12, 7, 3, 5, 13


def text(value: str) -> bytes:
    return struct.pack("<I", len(value)) + value.encode()


def record(code: int, content: bytes) -> bytes:
    return struct.pack("<BQ", code, len(content)) + content


def schema(number: int, name: str, encoding: str, data: bytes) -> bytes:
    return record(
        3, struct.pack("<H", number) + text(name) + text(encoding) + struct.pack("<I", len(data)) + data
    )


def channel(number: int, schema_number: int, topic: str, encoding: str) -> bytes:
    return record(4, struct.pack("<HH", number, schema_number) + text(topic) + text(encoding) + bytes(4))


def message(number: int, time_ns: int, data: bytes) -> bytes:
    return record(5, struct.pack("<HIQQ", number, 0, time_ns, time_ns) + data)


def chunk(records: bytes, compression: str = "", compressed: bytes | None = None) -> bytes:
    stored = records if compressed is None else compressed
    head = struct.pack("<QQQI", 0, 0, len(records), zlib.crc32(records))
    return record(6, head + text(compression) + struct.pack("<Q", len(stored)) + stored)


def mcap(path: Path, *records: bytes, profile: str = "") -> Path:
    magic = b"\x89MCAP0\r\n"
    end = record(15, bytes(4)) + record(2, bytes(20))
    path.write_bytes(magic + record(1, text(profile) + text("test")) + b"".join(records) + end + magic)
    return path


def json_records(rows: list[tuple[str, str, int, dict[str, Any]]]) -> list[bytes]:
    """Records of messages: topic, schema without its prefix, time, values."""
    names = list(dict.fromkeys((topic, kind) for topic, kind, _, _ in rows))
    records = []
    for number, (topic, kind) in enumerate(names, 1):
        records += [
            schema(number, f"foxglove.{kind}", "jsonschema", b"{}"),
            channel(number, number, topic, "json"),
        ]
    for topic, kind, time_ns, values in rows:
        records.append(message(names.index((topic, kind)) + 1, time_ns, json.dumps(values).encode()))
    return records


def varint(value: int) -> bytes:
    value &= 2**64 - 1
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*out, value])


def delimited(number: int, data: bytes) -> bytes:
    return varint(number << 3 | 2) + varint(len(data)) + data


def integer(number: int, value: int) -> bytes:
    return varint(number << 3) + varint(value)


def double(number: int, value: float) -> bytes:
    return varint(number << 3 | 1) + struct.pack("<d", value)


def fixed32(number: int, value: int) -> bytes:
    return varint(number << 3 | 5) + struct.pack("<I", value)


def declared_field(name: str, number: int, kind: int, type_name: str = "", repeated: bool = False) -> bytes:
    parts = (
        delimited(1, name.encode()) + integer(3, number) + integer(4, 3 if repeated else 1) + integer(5, kind)
    )
    return parts + (delimited(6, type_name.encode()) if type_name else b"")


def declared_type(name: str, *fields: bytes) -> bytes:
    return delimited(1, name.encode()) + b"".join(delimited(2, each) for each in fields)


def declared_file(package: str, *types: bytes) -> bytes:
    return delimited(1, delimited(2, package.encode()) + b"".join(delimited(4, each) for each in types))


TIMESTAMP = declared_file(
    "google.protobuf",
    declared_type("Timestamp", declared_field("seconds", 1, INT64), declared_field("nanos", 2, INT32)),
)
