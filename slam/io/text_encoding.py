"""Text that other programs wrote: UTF-8, UTF-16 with or without its mark, else the code page of Windows."""

from __future__ import annotations

import codecs

_PROBED_BYTES = 64
"""A text of one alphabet shows within some words on which side of its 16 bits the zeros stand."""
_LEAST_ZEROS = 0.75
"""Share of zeros on one side: digits and Latin letters of UTF-16 have them, other letters have not."""


def wide_encoding(head: bytes) -> str:
    """Return the name of the UTF-16 encoding in which a text begins, or "" for another one.

    Without a mark, the zeros beside Latin letters and digits tell.
    """
    if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    probed = head[: min(_PROBED_BYTES, len(head) // 2 * 2)]
    first, second = probed[::2], probed[1::2]
    least = _LEAST_ZEROS * len(first)
    if first and second.count(0) >= least and not first.count(0):
        return "utf-16-le"
    return "utf-16-be" if first and first.count(0) >= least and not second.count(0) else ""


def decode_text(data: bytes) -> tuple[str, str]:
    """Return the text of a file without its mark, and the name of its encoding.

    What is neither UTF-16 nor UTF-8 is taken as Windows-1252. There, numbers and units are those of most
    other code pages.
    """
    if wide := wide_encoding(data):
        return data.decode(wide, "replace").lstrip("\ufeff").rstrip("\0"), "UTF-16"
    try:
        return data.decode("utf-8-sig"), "UTF-8"
    except UnicodeDecodeError:
        return data.removeprefix(codecs.BOM_UTF8).decode("cp1252", "replace"), "Windows-1252"
