"""Ways in which files break: bits, cuts, lines, fields, numbers and nesting."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np

Rng = np.random.Generator

SPLICES = (
    b"\n", b",", b",,", b"\0", b"nan", b"inf", b"-", b"1e400", b"#", b'"', b"\r", b"\xff\xfe", b"_", b"'",
    b"9" * 30, b": ", b"[", b"]", b"{", b"&a ", b"*a", b"!!python/none ", b"- ", b"\t", b"../",
    b"\xe2\x80\xa8", b"\xef\xbb\xbf", b"\xd9\xa1", b"=", b"[[a]]\n", b"%", b"0x1f", b"1_0", b"<!", b"&#0;",
)  # fmt: skip
NUMBERS = (
    b"0", b"-0", b"-1", b"1", b"1e308", b"-1e308", b"1e-320", b"1e19", b"9223372036854775807",
    b"9223372036854775808", b"-9223372036854775808", b"18446744073709551616", b"4294967296", b"nan", b"-inf",
    b"1e9", b"1e-9", b"0.5", b"", b"true", b"null", b"0/0", b"1" + b"0" * 400, b"1" * 5000, b"3,5",
)  # fmt: skip
NUMBER = re.compile(rb"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?")


def mutated(data: bytes, rng: Rng) -> bytes:
    """Return data after one to three mutations."""
    for _ in range(int(rng.integers(1, 4))):
        data = _MUTATIONS[int(rng.integers(len(_MUTATIONS)))](data, rng) if data else b"x"
    return data


def _at(data: bytes, rng: Rng) -> tuple[int, int]:
    a, b = sorted(rng.integers(0, len(data), 2).tolist())
    return a, b


def _bit(data: bytes, rng: Rng) -> bytes:
    flipped = bytearray(data)
    flipped[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))
    return bytes(flipped)


def _cut(data: bytes, rng: Rng) -> bytes:
    return data[: _at(data, rng)[0]]


def _zeros(data: bytes, rng: Rng) -> bytes:
    a, _ = _at(data, rng)
    return data[:a] + bytes(len(data) - a)


def _splice(data: bytes, rng: Rng) -> bytes:
    a, _ = _at(data, rng)
    return data[:a] + SPLICES[int(rng.integers(len(SPLICES)))] + data[a:]


def _removed(data: bytes, rng: Rng) -> bytes:
    a, b = _at(data, rng)
    return data[:a] + data[b:]


def _repeated(data: bytes, rng: Rng) -> bytes:
    a, b = _at(data, rng)
    return data[:b] + data[a:b] + data[b:]


def _noise(data: bytes, rng: Rng) -> bytes:
    return rng.bytes(int(rng.integers(1, 200)))


def _lines(change: Callable[[list[bytes], int, int], object]) -> Callable[[bytes, Rng], bytes]:
    def mutate(data: bytes, rng: Rng) -> bytes:
        lines = data.split(b"\n")
        k, j = rng.integers(0, len(lines), 2).tolist()
        change(lines, k, j)
        return b"\n".join(lines)

    return mutate


def _swap(lines: list[bytes], k: int, j: int) -> None:
    lines[k], lines[j] = lines[j], lines[k]


def _field(data: bytes, rng: Rng) -> bytes:
    lines = data.split(b"\n")
    k = int(rng.integers(len(lines)))
    fields = lines[k].split(b",")
    fields[int(rng.integers(len(fields)))] = SPLICES[int(rng.integers(len(SPLICES)))]
    lines[k] = b",".join(fields)
    return b"\n".join(lines)


def _number(data: bytes, rng: Rng) -> bytes:
    """Replace one number by another one."""
    found = list(NUMBER.finditer(data))
    if not found:
        return data
    one = found[int(rng.integers(len(found)))]
    return data[: one.start()] + NUMBERS[int(rng.integers(len(NUMBERS)))] + data[one.end() :]


def _nested(data: bytes, rng: Rng) -> bytes:
    a, _ = _at(data, rng)
    opening, closing = ((b"[", b"]"), (b"{a: ", b"}"), (b"<a>", b"</a>"))[int(rng.integers(3))]
    deep = int(rng.choice([3, 50, 3000]))
    return data[:a] + opening * deep + closing * deep + data[a:]


_MUTATIONS: tuple[Callable[[bytes, Rng], bytes], ...] = (
    _bit, _cut, _zeros, _splice, _removed, _repeated, _noise, _field, _number, _number, _number, _nested,
    _lines(_swap),
    _lines(lambda lines, k, j: lines.insert(k, lines[j])),
    _lines(lambda lines, k, j: lines.pop(k)),
)  # fmt: skip
