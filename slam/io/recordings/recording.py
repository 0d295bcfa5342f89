"""The common form of all recordings: what they offer, and readings in the columns of a flight folder.

A format lists its channels as ``Offer`` objects: each can fill one stream of a flight. After the choice it
reads the chosen channels in one pass and returns ``StreamReadings`` in the units, axes and columns of the
flight format (`slam.io.streams.COLUMNS`). Everything after that is common to all formats.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera
from slam.core.messages import Message
from slam.core.progress import Progress
from slam.core.streams import Image
from slam.io.down_looking import Look
from slam.io.sensor_yaml import Value

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]

COPY_AGAIN = "copy the file again from the recorder if it has more"
"""Advice for a file that is damaged or cut short, but can be read in part."""


@dataclass(frozen=True, kw_only=True)
class Offer:
    """A channel of a recording that can fill one stream of a flight."""

    stream: str
    """Folder of the stream, for example ``imu0``."""
    channel: str
    """Name of the channel in the recording, for example ``/imu/data``."""
    kind: str
    """Type of its messages, for example ``sensor_msgs/msg/Imu``."""
    rows: int
    reading: str
    """Units and axes of the recording, and how they are converted."""
    rank: int = 0
    """Offers of a smaller rank are preferred."""
    is_indirect: bool = False
    """Whether the axes of the values are turned by another channel, or assumed; others are preferred."""
    look: Look = Look.DOWN
    """The direction of a camera, as far as it is known; it is more important than the rank."""
    is_declared: bool = False
    """Whether the recording itself states where a camera looks; otherwise its name is all that tells."""
    view: str = ""
    """A sentence about where a camera looks by its pictures; empty where they were not asked."""
    device: str = ""
    """Channels of one device show the same, for example compressed and not; empty for a device of its own."""
    doubt: str = ""
    """Reason not to take the channel without a request; empty for none."""


@dataclass(frozen=True)
class StreamReadings:
    """Readings of one stream in the columns, units and axes of the flight format."""

    stamps_ns: Stamps
    """(n,) in the order of the recording."""
    values: Array
    """(n, c) in the order of ``COLUMNS``, of which the last may be absent; NaN where missing."""
    nominal: Mapping[str, Value] = field(default_factory=dict)
    """Keys of ``sensor.yaml`` that the recording states."""
    notes: tuple[Message, ...] = ()
    """One line for everything that was dropped or assumed."""


@dataclass(frozen=True, kw_only=True)
class PictureChannel:
    """Pictures of the chosen camera; they stay in the recording until they are requested."""

    stamps_ns: Stamps
    names: tuple[str, ...]
    fetch: Callable[[int], Image | bytes]
    """Return picture k: its pixels, or the PNG or JPEG that the recording holds.

    It raises ``UnreadableImageError`` with the reason.
    """
    camera: Camera
    picture_format: str = "png"
    """Format in which pixels are written into a flight folder: "png" or "jpg"."""
    notes: tuple[Message, ...] = ()


@dataclass(frozen=True)
class Content:
    """The content of the chosen channels."""

    readings: Mapping[str, StreamReadings] = field(default_factory=dict)
    """Folder of the stream -> its readings."""
    pictures: PictureChannel | None = None
    warnings: tuple[Message, ...] = ()
    """Damage and assumptions that concern more than one stream."""
    metadata: Mapping[str, str] = field(default_factory=dict)
    """Notes of ``flight.yaml``: vehicle, date and the like."""


@dataclass(frozen=True)
class Burst:
    """Some successive pictures of a camera, and how the vehicle turned meanwhile."""

    stamps_s: Array
    """(k,)."""
    pictures: tuple[Image | None, ...]
    """k pictures, (h, w) or (h, w, 3); None where one is damaged."""
    w_R_b: Array | None = None
    """(k, 3, 3) attitudes of the vehicle, relative to each other; None where they are unknown. Axes of an
    instrument of unknown mount are taken as those of the body."""
    b_up: Array | None = None
    """(3,) the mean direction of up in these axes, of any length."""


Watch = Callable[[Offer, bool], tuple[Camera, Iterable[Burst]] | None]
"""Return the lens of a channel of pictures, and stretches of them; None where its lens is unknown.

If the second argument is true, pictures are watched alone: for longer, and without the instruments."""


@dataclass(frozen=True, kw_only=True)
class Recording:
    """An opened recording."""

    path: Path
    name: str
    description: str
    """Kind of the file, with its article: "a PX4 log"."""
    offers: tuple[Offer, ...]
    others: tuple[tuple[str, str, int], ...] = ()
    """Channels that no stream of a flight can take: name, type and number of rows."""
    unread: Mapping[str, str] = field(default_factory=dict)
    """Name of one of these -> why it is not read, where it would be of use otherwise."""
    read: Callable[[Sequence[Offer], Progress], Content]
    """Read the chosen channels. Raises ``InputError`` for damage that leaves nothing."""
    watch: Watch | None = None
    """None for a format that holds one camera at most."""
