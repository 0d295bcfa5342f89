"""The origin of a flight's stream: the channel of a recording that it was read from."""

from __future__ import annotations

from dataclasses import dataclass

NO_STREAM = "no stream of a flight"
"""The reason why a channel is left that nothing of a flight can hold."""


@dataclass(frozen=True, kw_only=True)
class StreamSource:
    """A channel of a recording, taken as a stream of the flight or left."""

    stream: str
    """Folder of the stream; empty for a channel that was left."""
    channel: str
    """Name in the recording, for example ``/imu/data``."""
    kind: str
    """Type of the messages."""
    rows: int
    rate_hz: float
    """Rows over the time between the first and the last; NaN where unknown."""
    reading: str
    """Units and axes, and how they were converted; of a channel that was left, the reason."""

    def line(self) -> str:
        """Return one line for ``sensor.yaml``."""
        return f"{self.channel} ({self.kind}): {self.reading}"
