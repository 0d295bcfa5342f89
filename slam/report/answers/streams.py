"""Streams of a flight in the words of a pilot, and the warnings that doubt them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from slam.core.messages import Message, by_kind

STREAM_WORDS: Mapping[str, str] = {
    "cam0": "the camera",
    "imu0": "gyro and accelerometer",
    "attitude0": "the attitude sensor (roll, pitch and heading)",
    "sonar0": "the height sensor",
    "gps0": "the GPS",
    "velocity0": "the vehicle's own velocity",
    "barometer0": "the barometer",
}
"""Name of a stream in messages -> in words."""


def doubts(messages: Iterable[Message]) -> tuple[Message, ...]:
    """Return the warnings that doubt an instrument, in their order; notes and other warnings doubt none."""
    return tuple(message for message in by_kind(messages).warnings if message.about in STREAM_WORDS)


def doubted(message: Message) -> str:
    """Return the stream and what was found of it, without the causes."""
    return f"{message.about}{':' * message.begins_with_colon} {message.verdict}"


def is_tilt_doubted(messages: Iterable[Message]) -> bool:
    """Return whether a warning doubts how level the map is."""
    return any(doubt.about == "attitude0" for doubt in doubts(messages))
