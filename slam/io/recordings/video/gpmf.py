"""Positions and the IMU that GoPro's cameras write into their videos (GPMF).

A track of a video holds one payload a second: nested blocks of a key, a type, and samples. The samples of a
payload are spread evenly over its time. ``GPS5`` holds latitude, longitude, altitude and speeds, and the fix
is in ``GPSF`` of the same block; ``GPS9`` (since the Hero 11) holds the fix in each sample. Source: GoPro,
gpmf-parser, "GPMF introduction" (README.md).
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from backend.wording import either
from slam.core.messages import Message, warning
from slam.io.recordings.logs.field_values import FIX_3D, known_fixes
from slam.io.recordings.recording import COPY_AGAIN, StreamReadings
from slam.io.recordings.video import gopro_imu
from slam.io.recordings.video.mp4 import Mp4Track

Array = NDArray[np.float64]

TRACK_CODE = "gpmd"
_TYPES = {"b": "i1", "B": "u1", "s": ">i2", "S": ">u2", "l": ">i4", "L": ">u4", "f": ">f4", "d": ">f8"}
_KEYS = ("GPS9", "GPS5")
"""Keys of positions; the first one that a video has is taken."""
_Attributes = dict[str, tuple[str, int, bytes]]
"""Key -> type, bytes of a sample, and content of what describes a series."""
_TURNED = "IORI"
"""Key of the rotations by which electronic stabilisation turned the pictures against the camera's body."""


@dataclass(frozen=True)
class GoproTrack:
    """The positions of a video, and the keys of its other series."""

    key: str
    """``GPS9`` or ``GPS5``; empty without positions."""
    positions: StreamReadings
    imu: StreamReadings
    """Gyro and accelerometer in body axes; empty where their axes are not known."""
    imu_axes: str
    """Axis of each channel of the gyro, as ``ORIN`` states it."""
    others: tuple[tuple[str, int], ...]
    """Key and number of samples of each other series."""
    damage: tuple[Message, ...] = ()
    """A line that counts the damaged payloads, if there are any."""
    stabilised_deg: float = 0.0
    """Largest angle by which the camera's electronic stabilisation turned a picture."""


def read_gopro(path: Path, track: Mp4Track) -> GoproTrack:
    """Return the positions in degrees and metres; without a fix they are NaN.

    A damaged payload ends at the damage, and is counted.
    """
    starts_s = np.concatenate([[0.0], np.cumsum(track.durations_s)])
    wanted = (*_KEYS, *gopro_imu.KEYS)
    stamps: dict[str, list[Array]] = {key: [np.empty(0)] for key in wanted}
    values: dict[str, list[Array]] = {key: [np.empty((0, 3))] for key in wanted}
    counts: dict[str, int] = {}
    imu_axes = ""
    damaged, stabilised_rad = 0, 0.0
    with path.open("rb") as file:
        for k, payload in enumerate(track.samples(file)):
            try:
                for key, count, found, axes in _streams(payload):
                    imu_axes = axes if key == "GYRO" else imu_axes
                    counts[key] = counts.get(key, 0) + count
                    if key == _TURNED and found is not None:
                        stabilised_rad = max(
                            stabilised_rad, float(Rotation.from_quat(found).magnitude().max())
                        )
                    elif found is not None:
                        stamps[key].append(starts_s[k] + np.arange(count) / count * track.durations_s[k])
                        values[key].append(found)
            except ValueError:
                damaged += 1
    key = next((key for key in _KEYS if counts.get(key)), "")
    taken = key or _KEYS[0]
    stamps_ns = np.round(np.concatenate(stamps[taken]) * 1e9).astype(np.int64)
    gyro, accel = ((np.concatenate(stamps[name]), np.vstack(values[name])) for name in gopro_imu.KEYS)
    imu_s, imu = gopro_imu.joined(*gyro, *accel)
    used = (key, *gopro_imu.KEYS) if len(imu_s) else (key,)
    others = tuple((name, count) for name, count in sorted(counts.items()) if name not in used)
    line = warning(
        f"{damaged} of {len(track.sizes)} payloads of GoPro's metadata {either(damaged, 'is', 'are')} "
        "damaged or of an unknown layout",
        COPY_AGAIN,
    )
    return GoproTrack(
        key=key,
        positions=StreamReadings(stamps_ns, np.vstack(values[taken])),
        imu=StreamReadings(np.round(imu_s * 1e9).astype(np.int64), imu),
        imu_axes=imu_axes,
        others=others,
        damage=(line,) * bool(damaged),
        stabilised_deg=math.degrees(stabilised_rad),
    )


def _streams(payload: bytes | None) -> Iterator[tuple[str, int, Array | None, str]]:
    """Yield key, number of samples, the samples that are read, and the axes of an IMU, of each series.

    Positions are latitude, longitude and altitude; the stabilisation is a quaternion, w first; an IMU is in
    body axes.

    Raises ``ValueError`` where the payload is damaged.
    """
    if payload is None:
        raise ValueError("the payload leads out of the file")
    for key, code, _, body in blocks(payload):
        if code == "\0" and key == "DEVC":
            model = ""
            for inner, inner_code, _, stream in blocks(body):
                if inner == "DVNM":
                    model = _text(stream)
                elif inner_code == "\0" and inner == "STRM":
                    yield from _stream(stream, model)


def _stream(body: bytes, model: str) -> Iterator[tuple[str, int, Array | None, str]]:
    parts = list(blocks(body))
    if not parts or not parts[-1][2]:
        return
    key, code, size, data = parts[-1]  # the samples stand behind what describes them
    attributes = {name: (kind, width, content) for name, kind, width, content in parts[:-1]}
    count = len(data) // size
    if key == _TURNED and code == "s" and size == 8 and count:
        turned = np.frombuffer(data[: count * size], ">i2").reshape(-1, 4).astype(float)
        known = turned[np.abs(turned).max(axis=1) > 0]
        yield key, count, known[:, [1, 2, 3, 0]] if len(known) else None, ""
        return
    if key in gopro_imu.KEYS and "SCAL" in attributes and count:
        axes = gopro_imu.axes_of(
            {name: _text(content) for name, (_, _, content) in attributes.items()}, model
        )
        values = _three_axes(data[: count * size], code, size, attributes)
        yield key, count, gopro_imu.in_body_axes(values, axes) if axes else None, axes
        return
    if key not in _KEYS or "SCAL" not in attributes or not count:
        yield key, count, None, ""
        return
    kinds = (
        attributes["TYPE"][2].decode("latin-1").strip("\0")
        if code == "?" and "TYPE" in attributes
        else code * (size // 4)
    )
    if any(kind not in _TYPES for kind in kinds) or len(kinds) < 3:
        raise ValueError("positions have an unknown layout")
    layout = np.dtype([(str(k), _TYPES[kind]) for k, kind in enumerate(kinds)])
    if layout.itemsize != size:
        raise ValueError("positions have another size than their layout")
    samples = np.frombuffer(data[: count * size], layout)
    columns = np.column_stack([samples[str(k)].astype(float) for k in range(len(kinds))])
    scale = _scale(attributes)
    position = columns[:, :3] / (scale[:3] if len(scale) >= 3 else scale[0])
    if key == "GPS9":
        fix = columns[:, -1]
    else:
        fix = np.full(
            count, int.from_bytes(attributes["GPSF"][2][:4], "big") if "GPSF" in attributes else FIX_3D
        )
    yield key, count, known_fixes(position, fix), ""


def _three_axes(data: bytes, code: str, size: int, attributes: _Attributes) -> Array:
    """Return readings (n, 3) in their unit. Raises ``ValueError`` for another layout."""
    kind = np.dtype(_TYPES.get(code, "V1"))
    if kind.kind == "V" or size != 3 * kind.itemsize:
        raise ValueError("an IMU has an unknown layout")
    values = np.frombuffer(data, kind).reshape(-1, 3).astype(float)
    scale = _scale(attributes)
    return np.asarray(values / (scale if len(scale) == 3 else scale[0]))


def _scale(attributes: _Attributes) -> Array:
    kind, _, content = attributes["SCAL"]
    scale = np.frombuffer(content, _TYPES.get(kind, ">i4")).astype(float)
    if not len(scale) or not scale.all():
        raise ValueError("readings have no scale")
    return scale


def _text(content: bytes) -> str:
    return content.decode("latin-1").strip("\0 ")


def blocks(data: bytes) -> Iterator[tuple[str, str, int, bytes]]:
    """Yield key, type, bytes of a sample, and content, up to the zeros that pad a payload.

    Raises ``ValueError`` for a block that is cut short.
    """
    at = 0
    while at + 8 <= len(data):
        key, code, size, count = struct.unpack(">4scBH", data[at : at + 8])
        end = at + 8 + size * count
        if key == b"\0\0\0\0":
            return
        if end > len(data):
            raise ValueError("a block leads out of its payload")
        yield key.decode("latin-1"), code.decode("latin-1"), size, data[at + 8 : end]
        at = end + -(size * count) % 4  # blocks begin at multiples of four bytes
