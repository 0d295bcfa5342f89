"""Choice of the channel that fills each stream of a flight."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass, field

from slam.core.errors import InputError
from slam.core.names import listed
from slam.core.streams import FIELD_BY_FOLDER
from slam.io.files import brief, refusal
from slam.io.recordings.recording import Offer, Recording

_MAX_LISTED = 8


@dataclass(frozen=True)
class Request:
    """Channels and rate that a user asks for."""

    topics: Mapping[str, str] = field(default_factory=dict)
    """Folder of a stream -> the channel to take; an empty name leaves the stream out."""
    picture_rate_hz: float | None = None
    """Largest number of pictures per second; None for all."""

    @property
    def is_empty(self) -> bool:
        """Whether nothing is asked for."""
        return not self.topics and self.picture_rate_hz is None


def choose(recording: Recording, topics: Mapping[str, str]) -> tuple[Offer, ...]:
    """Return the chosen offers, at most one for each stream.

    ``topics`` maps the folder of a stream to the channel that a user named; other streams take the offer of
    the smallest rank, and of equal ones the first. Cameras that look down come before all others, and values
    in known axes of the body before those that are turned. An empty
    channel name leaves the stream out. Raises ``InputError`` for an unknown stream or channel, and where
    nothing can be chosen.
    """
    for stream, channel in topics.items():
        _check(recording, stream, channel)
    chosen = []
    for stream in FIELD_BY_FOLDER:
        offers = [offer for offer in recording.offers if offer.stream == stream and offer.rows]
        if stream in topics:
            offers = [offer for offer in offers if offer.channel == topics[stream]]
        else:
            offers = [offer for offer in offers if not offer.doubt]
        if offers:
            chosen.append(min(offers, key=_preference))
    if not chosen:
        raise refusal(
            recording.path,
            f"is {recording.description} without a stream of a flight (found: {_found(recording)})",
            "record pictures or instruments, or convert them to a flight folder (docs/flight-format.md)",
        )
    return tuple(chosen)


def _preference(offer: Offer) -> tuple[int, bool, int]:
    return offer.look, offer.is_indirect, offer.rank


def next_best(recording: Recording, offer: Offer) -> bool:
    """Return whether another offer can take the place of one without a request."""
    others = (each for each in recording.offers if each.stream == offer.stream and each != offer)
    return any(each.rows and not each.doubt for each in others)


def _check(recording: Recording, stream: str, channel: str) -> None:
    if stream not in FIELD_BY_FOLDER:
        near = difflib.get_close_matches(stream, FIELD_BY_FOLDER, n=1, cutoff=0.6)
        hint = f"did you mean {near[0]}? " if near else ""
        raise InputError(
            f"--topic {brief(stream, 40)}={brief(channel, 80)}: no such stream; {hint}there are "
            f"{', '.join(FIELD_BY_FOLDER)}"
        )
    offered = [offer.channel for offer in recording.offers if offer.stream == stream]
    if channel and channel not in offered:
        have = listed(offered, _MAX_LISTED) or "none"
        raise refusal(
            recording.path,
            f"has no channel {brief(channel, 80)} that can be {stream}",
            f"channels that can: {have}",
        )


def _found(recording: Recording) -> str:
    kinds = [f"{each.channel} ({each.doubt})" for each in recording.offers if each.rows and each.doubt]
    kinds += [f"{name} ({recording.unread.get(name, kind)})" for name, kind, rows in recording.others if rows]
    return listed(kinds, _MAX_LISTED) or "nothing"
