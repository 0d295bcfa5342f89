"""Streams of a flight in the words of a pilot, and the warnings that doubt them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import NamedTuple

from slam.core.messages import by_kind

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


class Doubt(NamedTuple):
    """A warning that doubts an instrument: one that begins with the name of its stream."""

    stream: str
    """Stream with which the line begins."""
    line: str
    found: str
    """The finding: the line up to its first semicolon, without the name of the stream."""

    @property
    def sentence(self) -> str:
        """The stream and what was found of it, without the causes."""
        joint = ": " if self.line.startswith(f"{self.stream}:") else " "
        return f"{self.stream}{joint}{self.verdict}"

    @property
    def verdict(self) -> str:
        """The finding up to its first colon, behind which causes stand."""
        return self.found.split(": ")[0]

    def concerns(self, stream: str) -> bool:
        """Return whether what was found is about a stream; what to do about it may name others."""
        return stream == self.stream or stream in self.found


def doubts(warnings: Iterable[str]) -> tuple[Doubt, ...]:
    """Return the warnings that doubt an instrument, in their order; notes and other warnings doubt none."""
    found = []
    for line in by_kind(warnings).warnings:
        stream = line.split(maxsplit=1)[0].rstrip(":") if line.strip() else ""
        if stream in STREAM_WORDS:
            found.append(Doubt(stream, line, line.split(";")[0].removeprefix(stream).lstrip(": ")))
    return tuple(found)


def is_tilt_doubted(warnings: Iterable[str]) -> bool:
    """Return whether a warning doubts how level the map is."""
    return any(doubt.stream == "attitude0" for doubt in doubts(warnings))
