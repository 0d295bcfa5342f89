"""MCAP recordings with Foxglove's schemas in JSON or protobuf, read as ROS messages of the same meaning."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from slam.core.messages import Message, warning
from slam.io.files import brief, refusal
from slam.io.recordings.foxglove.messages import TRANSFORMS, decoder, meaning_of
from slam.io.recordings.mcap_file import McapChannel, McapFile
from slam.io.recordings.readers import damage_reported, optional_reader
from slam.io.recordings.recording import COPY_AGAIN, Recording
from slam.io.recordings.ros.open_bag import OpenBag
from slam.io.recordings.ros.rosbag import recording_of

DESCRIPTION = "an MCAP recording"
RosMessage = Any


@dataclass(frozen=True)
class _Connection:
    """A channel, with ROS's name of the type of its messages."""

    topic: str
    msgtype: str
    msgcount: int
    channel: McapChannel
    message: Callable[[bytes], RosMessage]


def open_recording(path: Path) -> Recording:
    """Open a recording. Raises ``InputError`` for a damaged one, or without its compression's package."""
    with damage_reported(path, DESCRIPTION), optional_reader(path, DESCRIPTION, "ros"):
        bag = FoxgloveBag(path)
    if not bag.connections:
        raise refusal(path, f"is {DESCRIPTION} without a complete message", "copy it again from the recorder")
    return recording_of(bag, DESCRIPTION)


class FoxgloveBag(OpenBag):
    """An open MCAP file with Foxglove's schemas."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._file = McapFile(path)
        self._connections = [_connection(each) for each in self._file.channels.values() if each.times_ns]
        self.warnings = _damage(self._file)
        self.add_constant_transforms(self.of_kinds(TRANSFORMS))  # Foxglove does not mark fixed ones
        self.find_first()
        self.find_body()

    @property
    def connections(self) -> Sequence[_Connection]:
        """All channels."""
        return self._connections

    @property
    def span_ns(self) -> tuple[int, int]:
        """The times of recording of the first and the last message."""
        times_ns = [c.channel.times_ns for c in self._connections]
        return min(map(min, times_ns), default=0), max(map(max, times_ns), default=0)

    def messages(
        self, connections: Sequence[_Connection], start_ns: int | None = None
    ) -> Iterator[tuple[_Connection, int, RosMessage]]:
        """Yield connection, time of recording [ns] and message, in the order of recording."""
        by_channel = {id(each.channel): each for each in connections}
        for channel, time_ns, data in self._file.messages([each.channel for each in connections], start_ns):
            connection = by_channel[id(channel)]
            yield connection, time_ns, connection.message(data)


def _damage(file: McapFile) -> tuple[Message, ...]:
    lines = []
    if file.lost_bytes:
        lines.append(
            warning(f"{file.lost_bytes:,} bytes are damaged or cut short, and were passed over", COPY_AGAIN)
        )
    if not file.has_end:
        lines.append(
            warning("the file ends without the record of its end: later messages are lost", COPY_AGAIN)
        )
    return tuple(lines)


def _connection(channel: McapChannel) -> _Connection:
    meaning = meaning_of(channel.schema)
    decode = decoder(channel.schema, channel.encoding) if meaning is not None else None
    count = len(channel.times_ns)
    if meaning is None or decode is None:
        name = channel.schema.name if channel.schema is not None else "without a schema"
        kind = f"{brief(name, 60)} ({brief(channel.encoding, 20)})"
        return _Connection(channel.topic, kind, count, channel, lambda data: None)
    kind, convert = meaning

    def message(data: bytes) -> RosMessage:
        try:
            return convert(decode(data))
        except (KeyError, TypeError, AttributeError, OverflowError) as error:
            raise ValueError(f"a message of {brief(channel.topic, 60)} lacks a field") from error

    return _Connection(channel.topic, kind, count, channel, message)
