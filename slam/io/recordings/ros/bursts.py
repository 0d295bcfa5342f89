"""Short stretches of a bag's pictures, with the turns of the vehicle meanwhile."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import takewhile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slam.core.flight import Image
from slam.core.rotations import rotation_of
from slam.io.images import UnreadableImageError, decode_image
from slam.io.levels import levels_of, range_of
from slam.io.recordings.recording import Burst
from slam.io.recordings.ros.camera import picture_of
from slam.io.recordings.ros.messages import RosRule
from slam.io.recordings.ros.open_bag import OpenBag

Array = NDArray[np.float64]
Message = Any


@dataclass(frozen=True)
class Schedule:
    """The moments at which pictures are taken from a recording."""

    most: int
    """Largest number of stretches, evenly over the recording: the cost does not grow with its length."""
    apart_s: float
    """Shortest time between the starts of two stretches, since errors of nearer ones are related."""
    after_s: tuple[float, ...]
    """Other pictures of a stretch are taken so long after its first one."""
    longest_s: float
    """A stretch ends after so long, where the recorder took fewer pictures."""


GLANCE = Schedule(most=32, apart_s=1.0, after_s=(0.2, 0.5), longest_s=2.0)
"""Short stretches for a comparison with instruments: a vehicle turns by some degrees meanwhile, the pictures
still overlap, and turns of a vehicle last about a second."""
CHAIN = Schedule(most=16, apart_s=3.0, after_s=(0.5, 1.0, 1.5, 2.0, 2.5), longest_s=5.0)
"""Long stretches for the pictures alone, in which a vehicle turns farther than it tilts; as many pictures."""
_AROUND_S = 0.2
"""Readings so long before and after the pictures are read: some of a slow attitude."""
_MAX_GAP_S = 0.25
"""Longest gap in the turns of the vehicle: between readings of a slow attitude."""
_LONGEST_TRANSPORT_S = 10.0
"""A header that is farther from the time of recording has another clock."""


@dataclass(frozen=True)
class BodyChannel:
    """A topic that shows how the vehicle turns and which way is up."""

    topic: str
    rule: RosRule

    def has_values(self, message: Message) -> bool:
        """Return whether a message has all its values; some drivers fill an ``Imu`` in part."""
        return bool(
            np.isfinite(self.rule.values(np.array([self.rule.row(message)], dtype=float), None)).all()
        )


def bursts_of(bag: OpenBag, topic: str, body: BodyChannel | None, when: Schedule) -> Iterator[Burst]:
    """Yield stretches of the pictures of a topic, evenly over the bag; damaged ones are left out."""
    begin_ns, end_ns = bag.span_ns
    count = int(np.clip((end_ns - begin_ns) * 1e-9 / when.apart_s, 1, when.most))
    starts = begin_ns + (np.arange(count) + 0.5) / count * (end_ns - begin_ns)
    for start_ns in starts.astype(np.int64).tolist():
        try:
            burst = _burst(bag, topic, body, start_ns, when)
        except Exception:  # noqa: BLE001  a reader's errors have no common class; the import tells of damage
            continue
        if burst is not None:
            yield burst


def _burst(bag: OpenBag, topic: str, body: BodyChannel | None, start_ns: int, when: Schedule) -> Burst | None:
    stamps_s: list[float] = []
    pictures: list[Image | None] = []
    recorded: list[int] = []
    for recorded_ns, stamp_s, message in _messages(bag, topic, start_ns):
        since_s = stamp_s - stamps_s[0] if stamps_s else 0.0
        if since_s > when.longest_s:
            break
        if not stamps_s or since_s >= when.after_s[len(stamps_s) - 1]:
            stamps_s.append(stamp_s)
            pictures.append(_picture(message))
            recorded.append(recorded_ns)
        if len(stamps_s) > len(when.after_s):
            break
    if len(stamps_s) < 2:
        return None
    attitude, up = None, None
    if body is not None:
        around_ns = int(_AROUND_S * 1e9)
        attitude, up = _turns(
            bag, body, np.array(stamps_s), recorded[0] - around_ns, recorded[-1] + around_ns
        )
    return Burst(np.array(stamps_s), tuple(pictures), attitude, up)


def _messages(bag: OpenBag, topic: str, start_ns: int) -> Iterator[tuple[int, float, Message]]:
    """Yield the time of recording [ns], the stamp [s] and the message from a time of recording on."""
    connections = [c for c in bag.connections if c.topic == topic]
    for _, recorded_ns, message in bag.messages(connections, start_ns):
        stamp_ns = recorded_ns
        if hasattr(message, "header"):
            stamp_ns = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
        if abs(stamp_ns - recorded_ns) > _LONGEST_TRANSPORT_S * 1e9:
            stamp_ns = recorded_ns
        yield recorded_ns, stamp_ns * 1e-9, message


def _picture(message: Message) -> Image | None:
    try:
        stored = picture_of(message)
        if isinstance(stored, bytes):
            return decode_image(stored)
        if stored.dtype == np.uint8:
            return np.asarray(stored, dtype=np.uint8)
        extent = range_of(stored)
        return None if extent is None else levels_of([extent], stored.dtype.kind in "ui").eight_bit(stored)
    except UnreadableImageError:
        return None


def _turns(
    bag: OpenBag, body: BodyChannel, stamps_s: Array, begin_ns: int, end_ns: int
) -> tuple[Array | None, Array | None]:
    """Return attitudes (k, 3, 3) at stamps (k,), relative to each other, and up (3,) in axes of the body.

    None where readings are missing.
    """
    read = takewhile(lambda each: each[0] <= end_ns, _messages(bag, body.topic, max(begin_ns, 0)))
    rows = [(stamp_s, *body.rule.row(message)) for _, stamp_s, message in read]
    table = np.array(rows, dtype=float).reshape(len(rows), -1)
    if not len(table):
        return None, None
    values = body.rule.values(table[:, 1:], None)
    good = np.isfinite(values).all(axis=1)
    at_s, first = np.unique(table[good, 0], return_index=True)
    values = values[good][first]
    if len(at_s) < 2 or at_s[0] > stamps_s[0] or at_s[-1] < stamps_s[-1] or np.diff(at_s).max() > _MAX_GAP_S:
        return None, None
    if body.rule.stream == "imu0":
        return _by_gyro(at_s, values, stamps_s)
    return _by_attitude(at_s, rotation_of(values), stamps_s)


def _by_gyro(at_s: Array, values: Array, stamps_s: Array) -> tuple[Array, Array]:
    from backend.clocks.delay_residuals import gyro_attitudes
    from backend.measurements import InertialReadings

    # Stamps of today in seconds resolve 0.2 us; nearer to zero they are exact.
    readings = InertialReadings(at_s - at_s[0], values[:, :3], values[:, 3:])
    return gyro_attitudes(readings, stamps_s - at_s[0]), values[:, 3:].mean(axis=0)


def _by_attitude(at_s: Array, w_R_b: Array, stamps_s: Array) -> tuple[Array, Array]:
    from scipy.spatial.transform import Rotation, Slerp

    turned = Slerp(at_s - at_s[0], Rotation.from_matrix(w_R_b))(stamps_s - at_s[0])
    return np.asarray(turned.as_matrix()), np.asarray(w_R_b[:, 2].mean(axis=0))
