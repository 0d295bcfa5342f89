"""Short stretches of a bag's pictures, with the turns of the vehicle meanwhile."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import takewhile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slam.core.errors import InputError
from slam.core.rotations import rotation_of
from slam.core.streams import Image
from slam.io.images import decode_image
from slam.io.levels import levels_of, range_of
from slam.io.picture_headers import UnreadableImageError
from slam.io.recordings.readers import damage_reported
from slam.io.recordings.recording import Burst
from slam.io.recordings.ros.camera import picture_of
from slam.io.recordings.ros.companions import LONGEST_GAP_S
from slam.io.recordings.ros.messages import RosRule
from slam.io.recordings.ros.open_bag import OpenBag
from slam.io.recordings.schedule import Schedule

Array = NDArray[np.float64]
RosMessage = Any

_AROUND_S = 0.2
"""Readings so long before and after the pictures are read: some of a slow attitude."""
LONGEST_TRANSPORT_S = 10.0
"""A message is recorded within seconds: a header farther from the time of recording has another clock."""


@dataclass(frozen=True)
class BodyChannel:
    """A topic that shows how the vehicle turns and which way is up."""

    topic: str
    rule: RosRule
    b_T_s: Array | None = None
    """(4, 4) mount of the instrument; None where it is unknown, and body axes are assumed."""

    def has_values(self, message: RosMessage) -> bool:
        """Return whether a message has all its values; some drivers fill an ``Imu`` in part."""
        if message is None or not self.rule.fits(message):
            return False
        return bool(
            np.isfinite(self.rule.values(np.array([self.rule.row(message)], dtype=float), None)).all()
        )


def bursts_of(bag: OpenBag, topic: str, body: BodyChannel | None, when: Schedule) -> Iterator[Burst]:
    """Yield stretches of the pictures of a topic, evenly over the bag; damaged ones are left out."""
    begin_ns, end_ns = bag.span_ns
    for after_s in when.starts_s((end_ns - begin_ns) * 1e-9).tolist():
        start_ns = begin_ns + int(after_s * 1e9)
        try:
            with damage_reported(bag.path, "a recording"):
                burst = _burst(bag, topic, body, start_ns, when)
        except InputError:  # the import reads all messages later, and tells of the damage
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


def _messages(bag: OpenBag, topic: str, start_ns: int) -> Iterator[tuple[int, float, RosMessage]]:
    """Yield the time of recording [ns], the stamp [s] and the message from a time of recording on."""
    connections = [c for c in bag.connections if c.topic == topic]
    for _, recorded_ns, message in bag.messages(connections, start_ns):
        stamp_ns = recorded_ns
        if hasattr(message, "header"):
            stamp_ns = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
        if abs(stamp_ns - recorded_ns) > LONGEST_TRANSPORT_S * 1e9:
            stamp_ns = recorded_ns
        yield recorded_ns, stamp_ns * 1e-9, message


def _picture(message: RosMessage) -> Image | None:
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
    values = body.rule.values(table[:, 1:], body.b_T_s)
    if body.rule.is_mounted and body.b_T_s is not None:
        values = (values.reshape(-1, 3) @ body.b_T_s[:3, :3].T).reshape(values.shape)
    good = np.isfinite(values).all(axis=1)
    at_s, first = np.unique(table[good, 0], return_index=True)
    values = values[good][first]
    if (
        len(at_s) < 2
        or at_s[0] > stamps_s[0]
        or at_s[-1] < stamps_s[-1]
        or np.diff(at_s).max() > LONGEST_GAP_S
    ):
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
