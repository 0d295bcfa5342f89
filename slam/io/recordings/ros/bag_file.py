"""An open ROS bag, read by ``rosbags``."""

from __future__ import annotations

import sqlite3
import weakref
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from slam.core.messages import Message, warning
from slam.io.recordings.readers import damage_reported, optional_reader
from slam.io.recordings.recording import COPY_AGAIN
from slam.io.recordings.ros.messages import TRANSFORM_KINDS
from slam.io.recordings.ros.open_bag import OpenBag
from slam.io.recordings.ros.px4 import PACKAGE
from slam.io.recordings.ros.transforms import transform_of

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader
    from rosbags.interfaces import Connection

RosMessage = Any

DESCRIPTION = "a ROS bag"


class Bag(OpenBag):
    """An open bag and its first messages; it is closed when it is no longer referenced."""

    def __init__(self, path: Path, *later: Path) -> None:
        """Open a bag, with the ``later`` parts of a ROS 1 bag that was split."""
        super().__init__(path, *later)
        with optional_reader(path, DESCRIPTION, "ros"):
            from rosbags.highlevel import AnyReader
            from rosbags.typesys import Stores, get_typestore
        # Bags hold the definitions of their messages since ROS 2 Iron.
        before_iron = get_typestore(Stores.ROS2_HUMBLE)
        with damage_reported(path, DESCRIPTION):
            self.reader: AnyReader = AnyReader([path, *later], default_typestore=before_iron)
            self._open()
        if any(c.msgtype.startswith(PACKAGE) and not self.is_defined(c.msgtype) for c in self.connections):
            self.warnings += (
                warning(
                    "the bag lacks the definitions of PX4's messages, so they are not read",
                    "ROS 2 before Iron stores them in MCAP only: ros2 bag record -s mcap",
                ),
            )
        weakref.finalize(self, self.reader.close)
        with damage_reported(path, DESCRIPTION):
            self._add_mounts()
            self.find_body()

    def _add_mounts(self) -> None:
        """Add the transforms of ``/tf_static``; where they miss a sensor, constant ones of ``/tf`` too."""
        transforms = self.of_kinds(*TRANSFORM_KINDS)
        static = [c for c in transforms if c.topic.endswith("tf_static")]
        for _, _, message in self.messages(static):
            for each in message.transforms:
                self.mounts.add(each.header.frame_id, each.child_frame_id, transform_of(each.transform))
        self.find_first()
        changing = [c for c in transforms if c not in static]
        frames = [frame for topic in self.first if (frame := self.frame_of(topic))]
        if all(self.mounts.knows(frame) for frame in frames):
            return
        if self.add_constant_transforms(changing):
            self.warnings += (
                warning("mounts are also taken from transforms of /tf that never change", "check T_BS"),
            )

    def _open(self) -> None:
        """Open the bag; of one that is damaged or has no index, read what is complete."""
        from rosbags.highlevel import AnyReaderError

        try:
            self.reader.open()
        except (AnyReaderError, OSError):
            found = self._damaged() if len(self.reader.paths) == 1 else None
            if found is None:
                raise
            reader, lost = found
            self.reader.readers = [reader]
            self.reader.open()
            self.warnings = (lost or _without_index(reader.lost_bytes),)

    def _damaged(self) -> tuple[Any, Message | None] | None:
        """Return a reader for the damaged file of this bag, and a warning; None where it cannot be read."""
        from slam.io.recordings.ros.cut_mcap import CutMcapReader, is_mcap
        from slam.io.recordings.ros.cut_sqlite import CutSqliteReader
        from slam.io.recordings.ros.unindexed import UnindexedReader

        file, reader = _only_file(self.path), None
        if file.suffix == ".db3":
            with suppress(sqlite3.Error):
                reader = CutSqliteReader(file)
            count = 0 if reader is None else sum(each.msgcount for each in reader.connections)
            lost = warning(f"the bag is damaged after {count} messages, and the rest is lost", COPY_AGAIN)
            return (reader, lost) if count else None
        unindexed: Any = None
        if is_mcap(file):
            unindexed = CutMcapReader(file)
        elif file.suffix == ".bag":
            unindexed = UnindexedReader(file)
        if unindexed is None or (is_mcap(file) and not any(c.msgcount for c in unindexed.connections)):
            return None
        return unindexed, None

    @property
    def connections(self) -> list[Connection]:
        """All connections of the bag."""
        return self.reader.connections

    @property
    def span_ns(self) -> tuple[int, int]:
        """The times of recording of the first and the last message."""
        return self.reader.start_time, self.reader.end_time - 1

    def is_defined(self, kind: str) -> bool:
        """Return whether the bag, or ROS itself, defines a type."""
        return kind in self.reader.typestore.types

    def messages(
        self, connections: Sequence[Connection], start_ns: int | None = None
    ) -> Iterator[tuple[Connection, int, RosMessage]]:
        """Yield connection, time of recording [ns] and message, in the order of recording."""
        if connections:
            for connection, time_ns, raw in self.reader.messages(connections, start=start_ns):
                yield connection, time_ns, self.reader.deserialize(raw, connection.msgtype)


def _without_index(lost_bytes: int) -> Message:
    lost = f", and its last {lost_bytes:,} bytes are lost" if lost_bytes else ""
    return warning(
        f"the bag has no index (its recording was interrupted){lost}", "end the next one before power is cut"
    )


def _only_file(path: Path) -> Path:
    """Return the file with messages of a bag's folder that holds a single one; otherwise the path itself."""
    files = [*path.glob("*.mcap"), *path.glob("*.db3")] if path.is_dir() else []
    return files[0] if len(files) == 1 else path
