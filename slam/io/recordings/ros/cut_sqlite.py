"""ROS 2 recordings in SQLite that are damaged or were cut short: the messages before the damage are read."""

from __future__ import annotations

import sqlite3
from array import array
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, suppress
from pathlib import Path

import numpy as np
from rosbags.interfaces import (
    Connection,
    ConnectionExtRosbag2,
    MessageDefinition,
    MessageDefinitionFormat,
)

from slam.io.recordings.ros.cut_mcap import DEFINITIONS


class CutSqliteReader(AbstractContextManager["CutSqliteReader"]):
    """A reader for ``rosbags.highlevel.AnyReader`` that takes messages in the order of their numbers.

    Raises ``sqlite3.Error`` where the topics cannot be read.
    """

    def __init__(self, path: Path) -> None:
        # A file that is shorter than its header states is only opened with a schema that may be written.
        self._database = sqlite3.connect(f"{path.absolute().as_uri()}?immutable=1", uri=True)
        self._database.execute("PRAGMA writable_schema=ON")
        self._numbers, self._topics, self._times_ns = array("q"), array("q"), array("q")
        with suppress(sqlite3.Error):
            rows = self._database.execute("SELECT id, topic_id, timestamp, data FROM messages ORDER BY id")
            for number, topic, time_ns, _ in rows:  # its data is read too, as that may be damaged alone
                self._numbers.append(number)
                self._topics.append(topic)
                self._times_ns.append(time_ns)
        definitions: dict[str, MessageDefinition] = {}
        with suppress(sqlite3.Error):  # recorders before ROS 2 Iron wrote none
            found = self._database.execute(
                "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
            )
            definitions = {kind: MessageDefinition(DEFINITIONS[form], text) for kind, form, text in found}
        none = MessageDefinition(MessageDefinitionFormat.NONE, "")
        self.connections = [
            Connection(
                id=topic,
                topic=name,
                msgtype=kind,
                msgdef=definitions.get(kind, none),
                digest="",
                msgcount=self._topics.count(topic),
                ext=ConnectionExtRosbag2(form, []),
                owner=self,
            )
            for topic, name, kind, form in self._database.execute(
                "SELECT id, name, type, serialization_format FROM topics ORDER BY id"
            )
        ]

    @property
    def start_time(self) -> int:
        """Time of the first message in nanoseconds."""
        return min(self._times_ns, default=0)

    @property
    def end_time(self) -> int:
        """Time after the last message in nanoseconds."""
        return max(self._times_ns, default=0) + 1

    def __exit__(self, *error: object) -> None:
        """Close the file."""
        self._database.close()

    def messages(
        self, connections: Sequence[Connection] = (), start: int | None = None, stop: int | None = None
    ) -> Iterator[tuple[Connection, int, bytes]]:
        """Yield connection, time of recording and data, in the order of time."""
        wanted = {each.id: each for each in connections or self.connections}
        times_ns = np.array(self._times_ns, dtype=np.int64)
        for k in np.argsort(times_ns, kind="stable").tolist():
            time_ns, topic = self._times_ns[k], self._topics[k]
            if topic in wanted and (start is None or time_ns >= start) and (stop is None or time_ns < stop):
                asked = (self._numbers[k],)
                (data,) = self._database.execute("SELECT data FROM messages WHERE id = ?", asked).fetchone()
                yield wanted[topic], time_ns, data
