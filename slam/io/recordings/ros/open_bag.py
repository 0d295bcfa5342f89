"""An open recording of ROS messages, or of messages with the same fields, in any container."""

from __future__ import annotations

import contextlib
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from frontend.camera import NADIR_B_T_C
from slam.core.messages import Message, warning
from slam.core.streams import Image
from slam.io.content_key import digest_with, source_key
from slam.io.files import brief
from slam.io.images import levels_of_sample, sample_of
from slam.io.levels import Raw
from slam.io.picture_headers import UnreadableImageError
from slam.io.recordings.ros.camera import info_of, picture_of
from slam.io.recordings.ros.messages import CAMERA_INFO, IMAGE_KINDS
from slam.io.recordings.ros.rules import RULES
from slam.io.recordings.ros.transforms import BODY_FRAMES, MountTree, is_optical, transform_of

Array = NDArray[np.float64]
RosMessage = Any

_IMU = "sensor_msgs/msg/Imu"


class Channel(Protocol):
    """The messages of one publisher."""

    @property
    def topic(self) -> str:
        """Name of the channel."""

    @property
    def msgtype(self) -> str:
        """ROS's name of the type of its messages."""

    @property
    def msgcount(self) -> int:
        """Number of its messages."""


class OpenBag(ABC):
    """Messages, the first one of each topic, and the mounts of the sensors."""

    def __init__(self, path: Path, *later: Path) -> None:
        """``later``: further files or folders of the same recording."""
        self.path, self.later = path, later
        self.warnings: tuple[Message, ...] = ()
        self.mounts = MountTree()
        self.first: dict[str, RosMessage] = {}
        """First message of each topic that can fill a stream."""
        self.body: str | None = None
        """Frame of the body; None where no transform is fixed."""

    @property
    @abstractmethod
    def connections(self) -> Sequence[Any]:
        """All ``Channel`` objects."""

    @property
    @abstractmethod
    def span_ns(self) -> tuple[int, int]:
        """The times of recording of the first and the last message."""

    @abstractmethod
    def messages(
        self, connections: Sequence[Any], start_ns: int | None = None
    ) -> Iterator[tuple[Any, int, RosMessage]]:
        """Yield connection, time of recording [ns] and message, in the order of recording."""

    @cached_property
    def _infos(self) -> list[tuple[str, RosMessage]]:
        """Topics with a ``CameraInfo``, and their first messages."""
        found = [(c.topic, self.first_message(c.topic)) for c in self.of_kinds(CAMERA_INFO)]
        return [(topic, message) for topic, message in found if message is not None]

    def camera_info(self, image_topic: str) -> RosMessage | None:
        """Return the calibration of a topic of pictures; None without."""
        return info_of(self._infos, image_topic, self.frame_of(image_topic))

    def find_first(self) -> None:
        """Read the first messages of the topics that can fill a stream."""
        kinds = {rule.kind for rule in RULES} | set(IMAGE_KINDS)
        defined = [kind for kind in kinds if self.is_defined(kind)]
        self.first = {topic: self.first_message(topic) for topic, _, count in self.topics(*defined) if count}

    def is_defined(self, kind: str) -> bool:
        """Return whether messages of a type can be read."""
        return True

    def find_body(self) -> None:
        """Find the frame of the body; the mounts and the first messages must be known.

        Without a usual name it is that of an IMU, unless that has optical axes (REP 103), which are no
        body's. Then a camera that has transforms is assumed to look straight down.
        """
        imus = [self.frame_of(c.topic) for c in self.of_kinds(_IMU)]
        self.body = self.mounts.body(frame for frame in imus if not is_optical(frame))
        cameras = [self.frame_of(c.topic) for c in self.of_kinds(*IMAGE_KINDS)]
        known = next((frame for frame in cameras if self.mounts.knows(frame)), None)
        if self.body is None and known is not None:
            self.body = BODY_FRAMES[0]
            self.mounts.add(self.body, known, NADIR_B_T_C)
            self.warnings += (
                warning(
                    f"no frame of the body is known: the camera of {brief(known, 40)!r} is assumed to look "
                    "straight down with the nose at the top, and other sensors are placed relative to it",
                    "record /tf_static",
                ),
            )

    def add_constant_transforms(self, connections: Sequence[Any]) -> bool:
        """Add the transforms that never change in some topics; return whether there is one.

        Publishers of fixed transforms that do not use ``/tf_static`` repeat them.
        """
        found: dict[tuple[str, str], Array | None] = {}
        for _, _, message in self.messages(connections):
            for each in message.transforms:
                pair, transform = (each.header.frame_id, each.child_frame_id), transform_of(each.transform)
                if pair not in found:
                    found[pair] = transform
                elif (before := found[pair]) is not None and not np.array_equal(before, transform):
                    found[pair] = None
        constant = [(pair, transform) for pair, transform in found.items() if transform is not None]
        for (parent, child), transform in constant:
            self.mounts.add(parent, child, transform)
        return bool(constant)

    def of_kinds(self, *kinds: str) -> list[Any]:
        """Return the connections with messages of some types."""
        return [c for c in self.connections if c.msgtype in kinds]

    def topics(self, *kinds: str) -> list[tuple[str, str, int]]:
        """Return topic, type and number of messages of all publishers, of some types or of all."""
        counts: Counter[tuple[str, str]] = Counter()
        for connection in self.connections:
            if not kinds or connection.msgtype in kinds:
                counts[connection.topic, connection.msgtype] += connection.msgcount
        return [(topic, kind, count) for (topic, kind), count in counts.items()]

    def frame_of(self, topic: str) -> str:
        """Return the frame in the header of the first message; empty without."""
        header = getattr(self.first.get(topic), "header", None)
        return str(header.frame_id) if header is not None else ""

    def mount_of(self, topic: str) -> Array | None:
        """Return ``b_T_s`` (4, 4) of the sensor of a topic; None where no fixed transform gives it."""
        return self.mounts.mount(self.body, self.frame_of(topic))

    def first_message(self, topic: str) -> RosMessage:
        """Return the first message of a topic; None without one."""
        connections = [c for c in self.connections if c.topic == topic]
        return next((message for _, _, message in self.messages(connections)), None)


class BagPictures:
    """Pictures of one topic by number: the next one is read on, any other one is looked up by time.

    Pixels of more than 8 bits are converted with one range for all of them, which is that of a sample.
    """

    def __init__(self, bag: OpenBag, connections: Sequence[Any], recorded_ns: NDArray[np.int64]) -> None:
        self._bag, self._connections = bag, connections
        self._recorded_ns = recorded_ns
        """(n,) time of recording of picture k, in the order of recording."""
        self._next = -1
        self._stream: Iterator[tuple[Any, int, RosMessage]] = iter(())
        self.notes: list[Message] = []
        """A line about the range of deep pixels."""
        self._levels = levels_of_sample(self._sample(), self.notes)

    def __call__(self, k: int) -> Image | bytes:
        """Return picture k. Raises ``UnreadableImageError``."""
        stored = self._stored(k)
        if isinstance(stored, bytes) or self._levels is None:
            return stored
        return self._levels.eight_bit(stored)

    def content_key(self, k: int) -> bytes | None:
        """Return a digest of the recording and of the place of picture k in it; None where it cannot be
        read."""
        topics = [(c.topic, c.msgtype) for c in self._connections]
        return digest_with(self._source_key, topics, int(self._recorded_ns[k]), k, self._levels)

    @cached_property
    def _source_key(self) -> bytes | None:
        return source_key((self._bag.path, *self._bag.later))

    def _sample(self) -> Iterator[tuple[Raw, bool]]:
        for k in sample_of(len(self._recorded_ns)):
            with contextlib.suppress(UnreadableImageError):
                stored = self._stored(k)
                if isinstance(stored, bytes) or stored.dtype == np.uint8:
                    return
                yield stored, True

    def _stored(self, k: int) -> Raw | bytes:
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
