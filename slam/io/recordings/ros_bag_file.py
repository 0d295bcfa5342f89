"""An open ROS bag: its messages, the mounts of its sensors, and single pictures on request."""

from __future__ import annotations

import weakref
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from slam.core.flight import Image
from slam.io.images import UnreadableImageError
from slam.io.recordings.readers import damage_reported, optional_reader
from slam.io.recordings.ros_camera import picture_of
from slam.io.recordings.ros_messages import IMAGE_KINDS, RULES, TRANSFORM_KINDS
from slam.io.recordings.transforms import MountTree, transform_of

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader
    from rosbags.interfaces import Connection

Array = NDArray[np.float64]
Message = Any

DESCRIPTION = "a ROS bag"


class Bag:
    """An open bag and its first messages; it is closed when it is no longer referenced."""

    def __init__(self, path: Path) -> None:
        with optional_reader(path, DESCRIPTION, "ros"):
            from rosbags.highlevel import AnyReader
            from rosbags.typesys import Stores, get_typestore
        self.path = path
        self.warnings: tuple[str, ...] = ()
        # Bags hold the definitions of their messages since ROS 2 Iron.
        before_iron = get_typestore(Stores.ROS2_HUMBLE)
        with damage_reported(path, DESCRIPTION):
            self.reader: AnyReader = AnyReader([path], default_typestore=before_iron)
            self._open()
        weakref.finalize(self, self.reader.close)
        self.mounts = MountTree()
        with damage_reported(path, DESCRIPTION):
            static = [c for c in self.of_kinds(*TRANSFORM_KINDS) if c.topic.endswith("tf_static")]
            for message in self.messages(static):
                for each in message[2].transforms:
                    self.mounts.add(each.header.frame_id, each.child_frame_id, transform_of(each.transform))
            kinds = {rule.kind for rule in RULES if rule.is_mounted} | set(IMAGE_KINDS)
            self.first = {topic: self._first(topic) for topic, _, count in self.topics(*kinds) if count}
        imus = [self.frame_of(c.topic) for c in self.of_kinds("sensor_msgs/msg/Imu")]
        self.body = self.mounts.body(imus)

    def _open(self) -> None:
        """Open the bag; of a ROS 1 bag without an index, read what is complete."""
        from rosbags.highlevel import AnyReaderError

        try:
            self.reader.open()
        except AnyReaderError:
            if self.path.suffix != ".bag":
                raise
            from slam.io.recordings.ros_unindexed import UnindexedReader

            unindexed = UnindexedReader(self.path)
            self.reader.readers = [unindexed]
            self.reader.open()
            lost = f", and its last {unindexed.lost_bytes:,} bytes are lost" if unindexed.lost_bytes else ""
            self.warnings = (f"the bag has no index (its recording was interrupted){lost}",)

    def of_kinds(self, *kinds: str) -> list[Connection]:
        """Return the connections with messages of some types."""
        return [c for c in self.reader.connections if c.msgtype in kinds]

    def topics(self, *kinds: str) -> list[tuple[str, str, int]]:
        """Return topic, type and number of messages of all publishers, of some types or of all."""
        counts: Counter[tuple[str, str]] = Counter()
        for connection in self.reader.connections:
            if not kinds or connection.msgtype in kinds:
                counts[connection.topic, connection.msgtype] += connection.msgcount
        return [(topic, kind, count) for (topic, kind), count in counts.items()]

    def messages(
        self, connections: Sequence[Connection], start_ns: int | None = None
    ) -> Iterator[tuple[Connection, int, Message]]:
        """Yield connection, time of recording [ns] and message, in the order of recording."""
        if connections:
            for connection, time_ns, raw in self.reader.messages(connections, start=start_ns):
                yield connection, time_ns, self.reader.deserialize(raw, connection.msgtype)

    def frame_of(self, topic: str) -> str:
        """Return the frame in the header of the first message; empty without."""
        header = getattr(self.first.get(topic), "header", None)
        return str(header.frame_id) if header is not None else ""

    def mount_of(self, topic: str) -> Array | None:
        """Return ``b_T_s`` (4, 4) of the sensor of a topic; None where no fixed transform gives it."""
        return self.mounts.mount(self.body, self.frame_of(topic))

    def _first(self, topic: str) -> Message:
        connections = [c for c in self.reader.connections if c.topic == topic]
        return next((message for _, _, message in self.messages(connections)), None)


class BagPictures:
    """Pictures of one topic by number: the next one is read on, any other one is looked up by time."""

    def __init__(self, bag: Bag, connections: Sequence[Connection], recorded_ns: NDArray[np.int64]) -> None:
        self._bag, self._connections = bag, connections
        self._recorded_ns = recorded_ns
        """(n,) time of recording of picture k, in the order of recording."""
        self._next = -1
        self._stream: Iterator[tuple[Connection, int, Message]] = iter(())

    def __call__(self, k: int) -> Image | bytes:
        """Return picture k. Raises ``UnreadableImageError``."""
        try:
            if k != self._next:
                self._seek(k)
            _, _, message = next(self._stream)
            self._next = k + 1
            return picture_of(message)
        except UnreadableImageError:
            raise
        except Exception as error:
            self._next = -1
            raise UnreadableImageError("damaged") from error

    def _seek(self, k: int) -> None:
        start_ns = int(self._recorded_ns[k])
        self._stream = self._bag.messages(self._connections, start_ns)
        # Several pictures may have been recorded at the same time.
        for _ in range(k - int(np.searchsorted(self._recorded_ns, start_ns))):
            next(self._stream)
