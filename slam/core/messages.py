"""Messages about a flight and its map: what was found, what it concerns, and whether somebody has to act."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import NamedTuple

_JOINED_BY = "; "
CHECKED_BY_ONE_DISTANCE = "Measure one distance on the ground to check the lengths."
"""End of a sentence about lengths that a single instrument tells."""


class Kind(StrEnum):
    """How grave a message is: stated where it is made, and all that is asked where it is shown."""

    REASON = "reason"
    """The map may be wrong beyond its covariances: the status names it."""
    WARNING = "warning"
    """The map may be incomplete, or an instrument needs care."""
    UNREAD = "unread"
    """A warning that a recorded stream could not be read, so that the flight is without it."""
    NOTE = "note"
    """Nobody has to act: the program has done what is needed, and accuracy and extent of the map as stated
    hold with it."""


@dataclass(frozen=True)
class Message:
    """One line of text for a person, in clauses."""

    clauses: tuple[str, ...]
    """The first says what was found, with its causes after a colon, and the last what to do."""
    kind: Kind = Kind.WARNING
    about: str = ""
    """Name of the stream or file that it concerns, with which the finding begins; empty for the whole map."""

    def __str__(self) -> str:
        return self.text

    @property
    def text(self) -> str:
        """The message as one line, its clauses joined by semicolons."""
        return _JOINED_BY.join(self.clauses)

    def prefixed(self, words: str) -> Message:
        """Return the message with words in front."""
        first, *others = self.clauses or ("",)
        return replace(self, clauses=(f"{words} {first}", *others))

    def after(self, name: str) -> Message:
        """Return the message with a name in front, such as that of one of several flights."""
        return self.prefixed(f"{name}:")

    def named(self, name: str) -> Message:
        """Return the message as one about a stream or file, with its name in front."""
        return replace(self.after(name), about=name)

    def concerning(self, name: str) -> Message:
        """Return the message as one about a stream or file that its text names already."""
        return replace(self, about=name)

    def extended(self, *clauses: str) -> Message:
        """Return the message with further clauses; empty ones are left out."""
        return replace(self, clauses=(*self.clauses, *filter(None, clauses)))

    def as_note(self) -> Message:
        """Return the message as one that needs no action."""
        return replace(self, kind=Kind.NOTE)

    def as_reason(self) -> Message:
        """Return the message as a reason for the status."""
        return replace(self, kind=Kind.REASON)

    @property
    def sentences(self) -> str:
        """The clauses as sentences for a page."""
        first, *others = self.clauses or ("",)
        text = ". ".join([first.rstrip("."), *(_capital(other).rstrip(".") for other in others)])
        return text if text.endswith(("?", "!", ":")) or not text else f"{text}."

    @property
    def finding(self) -> str:
        """The first clause without the name of what it is about."""
        first = next(iter(self.clauses), "")
        return first.partition(self.about)[2].lstrip(": ") if self.about else first

    @property
    def verdict(self) -> str:
        """The finding without its causes."""
        return self.finding.split(": ")[0]

    @property
    def begins_with_colon(self) -> bool:
        """Whether a colon stands between the name and the finding, which is then no sentence with it."""
        return self.text.partition(self.about)[2].startswith(":")

    @property
    def next_step(self) -> str:
        """The last clause, which says what to do; empty where the message is a finding alone."""
        return self.clauses[-1].rstrip(".") if len(self.clauses) > 1 else ""


def warning(*clauses: str) -> Message:
    """Return a warning about nothing in particular; empty clauses are left out."""
    return Message(tuple(filter(None, clauses)))


def about(name: str, *clauses: str) -> Message:
    """Return a warning about a stream or file, with its name in front."""
    return warning(*clauses).named(name)


def note(*clauses: str) -> Message:
    """Return a message that needs no action."""
    return warning(*clauses).as_note()


def reason(*clauses: str) -> Message:
    """Return a reason for the status."""
    return warning(*clauses).as_reason()


def unread(*clauses: str) -> Message:
    """Return a warning about a stream that could not be read."""
    return replace(warning(*clauses), kind=Kind.UNREAD)


def parsed(text: str) -> Message:
    """Return a warning of which another package, or an error, has made the text."""
    return Message(clauses_of(text))


def recorded(text: str, notes: Iterable[str] = ()) -> Message:
    """Return a message of which a file holds the text; ``notes`` are the texts of those that are notes.

    A file of text keeps what a message is about only as its first word, and its clauses by their semicolons.
    """
    name = text.split(maxsplit=1)[0].rstrip(":,") if text.strip() else ""
    return Message(clauses_of(text), Kind.NOTE if text in notes else Kind.WARNING, name)


def clauses_of(text: str) -> tuple[str, ...]:
    """Return the clauses that semicolons join in a text; one within brackets joins none."""
    found, depth, begin = [], 0, 0
    for k, character in enumerate(text):
        depth += (character in "([{") - (character in ")]}")
        if depth <= 0 and text.startswith(_JOINED_BY, k):
            found.append(text[begin:k])
            begin = k + len(_JOINED_BY)
    found.append(text[begin:])
    return tuple(filter(None, found))


class ByKind(NamedTuple):
    """Messages by kind, each kind in their order."""

    reasons: tuple[Message, ...]
    others: tuple[Message, ...]
    """Warnings that the status does not name."""
    notes: tuple[Message, ...]

    @property
    def warnings(self) -> tuple[Message, ...]:
        """All that somebody has to act on."""
        return self.reasons + self.others

    @property
    def status(self) -> str:
        """``ok``, or the reasons in one line."""
        return "; ".join(map(str, self.reasons)) or "ok"


def by_kind(messages: Iterable[Message]) -> ByKind:
    """Return reasons, other warnings and notes apart."""
    messages = tuple(messages)
    reasons = tuple(message for message in messages if message.kind is Kind.REASON)
    notes = tuple(message for message in messages if message.kind is Kind.NOTE)
    others = tuple(m for m in messages if m.kind in (Kind.WARNING, Kind.UNREAD))
    return ByKind(reasons, others, notes)


def joined(*messages: Message | None) -> tuple[Message, ...]:
    """Return the messages of a result by their kinds, each text once, of the kind that comes first.

    An empty message is left out, and None.
    """
    once: dict[str, Message] = {}
    for message in messages:
        if message is not None and message.clauses:
            once.setdefault(message.text, message)
    found = by_kind(once.values())
    return found.warnings + found.notes


def _capital(clause: str) -> str:
    """Return a clause as the beginning of a sentence; names of streams and files keep their letters."""
    word = clause.split(" ")[0].rstrip(":,")
    is_name = any(character in word for character in "._/0123456789")
    return clause if is_name else clause[:1].upper() + clause[1:]
