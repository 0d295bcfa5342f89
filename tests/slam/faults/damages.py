"""Ways to break the files of a flight folder."""

from __future__ import annotations

import os
import re
import shutil
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

from tests.slam.faults.fault import Damage

Rows = list[list[str]]


def rows(stream: str, change: Callable[[Rows], Rows]) -> Damage:
    """Change the table of a stream, without its header."""

    def damage(flight: Path) -> None:
        path = flight / "mav0" / stream / "data.csv"
        header, *lines = path.read_text().splitlines()
        changed = change([line.split(",") for line in lines])
        path.write_text("\n".join([header, *map(",".join, changed)]) + "\n")

    return damage


def column(stream: str, at: int, change: Callable[[str], object], every: int = 1) -> Damage:
    """Change the values of one column, in all rows or in some."""

    def changed(table: Rows) -> Rows:
        return [
            [*r[:at], str(change(r[at])), *r[at + 1 :]] if k % every == every // 2 else r
            for k, r in enumerate(table)
        ]

    return rows(stream, changed)


def data(name: str, change: Callable[[bytes], bytes]) -> Damage:
    """Change the bytes of a file of the input."""

    def damage(folder: Path) -> None:
        (folder / name).write_bytes(change((folder / name).read_bytes()))

    return damage


def pictures(change: Callable[[bytes], bytes], every: int = 1) -> Damage:
    """Change the bytes of pictures of a flight."""

    def damage(flight: Path) -> None:
        for path in sorted((flight / "mav0" / "cam0" / "data").iterdir())[:: max(every, 1)]:
            path.write_bytes(change(path.read_bytes()))

    return damage


def key(name: str, pattern: str, value: str) -> Damage:
    """Replace a part of a stream's ``sensor.yaml``."""

    def damage(flight: Path) -> None:
        path = flight / "mav0" / name / "sensor.yaml"
        text, count = re.subn(pattern, value, path.read_text(), count=1, flags=re.DOTALL)
        assert count
        path.write_text(text)

    return damage


def without(stream: str) -> Damage:
    """Remove a stream."""
    return lambda flight: shutil.rmtree(flight / "mav0" / stream)


def file(name: str, content: bytes) -> Callable[[Path], Path]:
    """Write a file into the input, and give it to the command alone."""

    def damage(folder: Path) -> Path:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
        return folder / name

    return damage


def also(name: str, content: bytes) -> Damage:
    """Write a file into the input."""
    return lambda folder: (folder / name).write_bytes(content)


def pipe(flight: Path) -> None:
    """A pipe in place of a file."""
    path = flight / "mav0" / "sonar0" / "data.csv"
    path.unlink()
    os.mkfifo(path)


def folder_for_file(flight: Path) -> None:
    """A folder in place of a file."""
    path = flight / "mav0" / "sonar0" / "data.csv"
    path.unlink()
    path.mkdir()


def linked(flight: Path) -> None:
    """A stream behind a link that leaves the flight."""
    outside = shutil.move(flight / "mav0" / "sonar0", flight.parent / "outside")
    (flight / "mav0" / "sonar0").symlink_to(outside)


def png_bomb(_: bytes) -> bytes:
    """A PNG that says it is 6 GB."""
    chunk = b"IHDR" + struct.pack(">IIBBBBB", 40_000, 49_000, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + chunk + struct.pack(">I", zlib.crc32(chunk))


def flipped(content: bytes, at: int = -40) -> bytes:
    """The content with one bit of one byte flipped."""
    broken = bytearray(content)
    broken[at] ^= 4
    return bytes(broken)


def later(ns: int) -> Callable[[Rows], Rows]:
    """Shift the stamps of the second half."""
    return lambda t: [[str(int(r[0]) + ns * (k >= len(t) // 2)), *r[1:]] for k, r in enumerate(t)]
