"""A small PX4 log, written byte by byte after the PX4 user guide, "ULog file format"."""

from __future__ import annotations

import struct
from pathlib import Path

HEADER = b"ULog\x01\x12\x35\x01"


def message(kind: bytes, body: bytes) -> bytes:
    return struct.pack("<HB", len(body), kind[0]) + body


def log(path: Path, topics: dict[str, tuple[str, str, list[tuple]]], tail: bytes = b"") -> Path:
    """Write topics: name -> (ULog fields after the stamp, struct codes, rows).

    A row begins with the stamp in microseconds. A name may end in the number of the instance, as
    ``battery_status[1]``.
    """
    parts = [HEADER + struct.pack("<Q", 0), message(b"B", bytes(40)), message(b"I", _info("sys_name", "PX4"))]
    formats = {name.partition("[")[0]: fields for name, (fields, _, _) in topics.items()}
    parts += [
        message(b"F", f"{name}:uint64_t timestamp;{fields}".encode()) for name, fields in formats.items()
    ]
    for number, (name, (_, codes, rows)) in enumerate(topics.items()):
        kind, _, instance = name.rstrip("]").partition("[")
        parts.append(message(b"A", struct.pack("<BH", int(instance or 0), number) + kind.encode()))
        parts += [message(b"D", struct.pack("<HQ" + codes, number, *row)) for row in rows]
    path.write_bytes(b"".join(parts) + tail)
    return path


def _info(key: str, value: str) -> bytes:
    text = f"char[{len(value)}] {key}".encode()
    return bytes([len(text)]) + text + value.encode()
