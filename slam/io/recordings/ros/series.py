"""The messages of one topic of a ROS recording, as they are read."""

from __future__ import annotations

import zlib
from array import array
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from backend.wording import counted
from slam.core.messages import Message, warning
from slam.io.recordings.ros.messages import RosRule
from slam.io.recordings.ros.px4 import PACKAGE

Array = NDArray[np.float64]
RosMessage = Any


@dataclass
class TopicSeries:
    """Messages of one topic, as they are read."""

    rule: RosRule | None
    """None for pictures."""
    stamps_ns: array[int] = field(default_factory=lambda: array("q"))
    recorded_ns: array[int] = field(default_factory=lambda: array("q"))
    rows: array[float] = field(default_factory=lambda: array("d"))
    checksums: array[int] = field(default_factory=lambda: array("q"))
    """CRC-32 of the content of each picture; empty for other topics."""
    first: RosMessage = None
    without_stamp: int = 0
    has_header: bool = True
    is_of_px4: bool = False
    """Whether messages have PX4's stamp, in microseconds, instead of a header."""

    def add(self, recorded_ns: int, message: RosMessage) -> None:
        """Add a message with its time of recording [ns]."""
        if self.first is None:
            self.first, self.has_header = message, hasattr(message, "header")
            self.is_of_px4 = self.rule is not None and self.rule.kind.startswith(PACKAGE)
        stamp_ns = 0
        if self.has_header:
            stamp_ns = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
        elif self.is_of_px4:
            stamp_ns = int(message.timestamp) * 1000
        self.without_stamp += stamp_ns == 0
        self.stamps_ns.append(stamp_ns or recorded_ns)
        self.recorded_ns.append(recorded_ns)
        if self.rule is not None:
            self.rows.extend(self.rule.row(message))
        else:
            self.checksums.append(zlib.crc32(bytes(message.data)))

    def table(self) -> tuple[NDArray[np.int64], Array]:
        """Return stamps (n,) and rows (n, c)."""
        stamps_ns = np.array(self.stamps_ns, dtype=np.int64)
        return stamps_ns, np.array(self.rows).reshape(len(stamps_ns), -1)

    def picture_names(self, suffix: str) -> tuple[str, ...]:
        """Return a name for each picture, from its stamp; only pictures of equal stamp and content share one.

        The clock of a header may step back, so that different pictures have one stamp.
        """
        contents: dict[int, dict[int, int]] = {}
        names = []
        for stamp_ns, checksum in zip(self.stamps_ns, self.checksums, strict=True):
            known = contents.setdefault(stamp_ns, {})
            number = known.setdefault(checksum, len(known))
            names.append(f"{stamp_ns}_{number}{suffix}" if number else f"{stamp_ns}{suffix}")
        return tuple(names)

    def notes(self) -> list[Message]:
        """Return a line where stamps are those of the recorder."""
        if not self.without_stamp:
            return []
        what = (
            "messages have no header"
            if not (self.has_header or self.is_of_px4)
            else counted(self.without_stamp, "stamp is zero", "stamps are zero")
        )
        return [warning(f"{what}: the time of recording is used", "stamp them where they are measured")]
