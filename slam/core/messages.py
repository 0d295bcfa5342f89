"""Kinds of messages about a flight and its map, and their sentences.

A message is a line of text. It is a `Note` where the program has done what is needed, and the accuracy and
the extent of the map as stated hold with it: nobody has to act. Every other message is a warning: the map may
be wrong or incomplete beyond what it states, or an instrument needs care, and the line says what to do. The
kind is given where the message is made; whoever shows messages asks `is_note` only.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

CHECKED_BY_ONE_DISTANCE = "Measure one distance on the ground to check the lengths."
"""End of a sentence about lengths that a single instrument tells."""


class Note(str):
    """A message that needs no action; see the module."""

    __slots__ = ()


class Sorted(NamedTuple):
    """Messages by kind, each kind in their order."""

    warnings: tuple[str, ...]
    notes: tuple[str, ...]


def is_note(line: str) -> bool:
    """Return whether a message needs no action."""
    return isinstance(line, Note)


def same_kind(line: str, text: str) -> str:
    """Return ``text``, a shortened or extended ``line``, as a message of the kind of ``line``."""
    return Note(text) if is_note(line) else text


def by_kind(lines: Iterable[str]) -> Sorted:
    """Return warnings and notes apart."""
    lines = tuple(lines)
    return Sorted(tuple(x for x in lines if not is_note(x)), tuple(x for x in lines if is_note(x)))


def with_notes(lines: Iterable[str], notes: Iterable[str]) -> tuple[str, ...]:
    """Return lines that were read from a file, with their kinds: ``notes`` are those that are notes."""
    known = frozenset(map(str, notes))
    return tuple(Note(line) if line in known else line for line in lines)


def reasons_of(status: str, lines: Iterable[str]) -> tuple[str, ...]:
    """Return the reasons that a status joins, each a line of ``lines`` too, in their order in the status.

    A status whose reasons are not all among the lines is one reason; ``ok`` has none.
    """
    if status == "ok":
        return ()
    found = sorted((status.find(line), -len(line), line) for line in lines if line and line in status)
    reasons, end = list[str](), 0
    for begin, _, line in found:
        if begin == end + (len("; ") if reasons else 0):
            reasons.append(line)
            end = begin + len(line)
    return tuple(reasons) if end == len(status) else (status,)


def clauses(line: str) -> list[str]:
    """Return the clauses of a message, which semicolons join; one within brackets joins none."""
    found, depth, begin = [], 0, 0
    for k, character in enumerate(line):
        depth += (character in "([{") - (character in ")]}")
        if character == ";" and depth <= 0:
            found.append(line[begin:k].strip())
            begin = k + 1
    found.append(line[begin:].strip())
    return [clause for clause in found if clause]


def sentences(line: str) -> str:
    """Return a message, whose `clauses` are joined by semicolons, as sentences for a page."""
    first, *others = clauses(line) or [""]
    text = ". ".join([first.rstrip("."), *(_capital(other).rstrip(".") for other in others)])
    return text if text.endswith(("?", "!", ":")) or not text else f"{text}."


def _capital(clause: str) -> str:
    """Return a clause as the beginning of a sentence; names of streams and files keep their letters."""
    word = clause.split(" ")[0].rstrip(":,")
    is_name = any(character in word for character in "._/0123456789")
    return clause if is_name else clause[:1].upper() + clause[1:]
