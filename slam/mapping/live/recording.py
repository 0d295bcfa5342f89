"""Stamps, pictures of keyframes, and readings of instruments that arrive in flight, as a `Flight`."""

from __future__ import annotations

import tempfile
import threading
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.tracked import Keyframe
from slam.core.errors import InputError
from slam.core.flight import Flight
from slam.core.streams import AttitudeSeries, Frames, Image, Imu, Sonar

Array = NDArray[np.float64]

_RECENT = 100
"""Readings that are looked at for a keyframe: it is one of the last pictures."""


class LiveRecording:
    """Stamps and readings that were given, beside the streams of a flight that has them already.

    Pictures of keyframes are kept in a temporary folder: only one thread may read those of the flight.
    """

    def __init__(self, flight: Flight) -> None:
        self.name = flight.name
        self._flight, self._lock = flight, threading.Lock()
        self._stamps_s: list[float] = []
        self._attitudes: list[tuple[float, Array]] = []
        self._ranges: list[tuple[float, float]] = []
        self._imu: list[Imu] = []
        self._folder = tempfile.TemporaryDirectory(prefix="slam-live-")

    def __len__(self) -> int:
        return len(self._stamps_s)

    def stamp_s(self, frame: int) -> float:
        """Return the time of a frame."""
        return self._stamps_s[frame]

    def add(
        self,
        stamp_s: float,
        roll_pitch_yaw_rad: Array | None = None,
        range_m: float | None = None,
        imu: Imu | None = None,
    ) -> int:
        """Keep what arrived and return the number of the frame. Raises ``InputError`` for a stamp that is
        not after the one before, for an attitude that is not three angles, and for readings of an IMU that
        are not three for each stamp."""
        angles = None if roll_pitch_yaw_rad is None else np.asarray(roll_pitch_yaw_rad, dtype=float)
        if angles is not None and angles.shape != (3,):
            raise InputError(f"{self.name}: roll_pitch_yaw_rad has shape {angles.shape}; give three angles")
        if imu is not None:
            self._check_shapes(imu)
        if not np.isfinite(stamp_s):
            raise InputError(f"{self.name}: the stamp of a picture is {stamp_s}; give seconds")
        with self._lock:
            if self._stamps_s and not stamp_s > self._stamps_s[-1]:
                raise InputError(
                    f"{self.name}: the picture at {stamp_s} s is not after the one before, at "
                    f"{self._stamps_s[-1]} s; give pictures in the order of their times"
                )
            number = len(self._stamps_s)
            self._stamps_s.append(float(stamp_s))
            if angles is not None:
                self._attitudes.append((stamp_s, angles))
            if range_m is not None:
                self._ranges.append((stamp_s, float(range_m)))
            if imu is not None and len(imu.stamps_s):
                self._imu.append(imu)
            return number

    def refresh(self, flight: Flight) -> None:
        """Take another state of the flight, whose streams have grown."""
        with self._lock:
            self._flight = flight

    def _check_shapes(self, imu: Imu) -> None:
        count = len(imu.stamps_s)
        for name, values in (("gyro_rad_s", imu.gyro_rad_s), ("accel_m_s2", imu.accel_m_s2)):
            if np.shape(values) != (count, 3):
                raise InputError(
                    f"{self.name}: {name} has shape {np.shape(values)} for {count} stamps; give three axes "
                    "of each reading"
                )

    def keep(self, keyframe: Keyframe) -> None:
        """Keep the picture of a keyframe. Raises ``InputError`` where the disk refuses it."""
        assert keyframe.image is not None
        fast = [cv2.IMWRITE_PNG_COMPRESSION, 1]
        if not cv2.imwrite(str(self._path(keyframe.frame)), keyframe.image, fast):
            raise InputError(f"{self._folder.name}: cannot be written; free space for temporary files")

    def picture(self, frame: int) -> Image | None:
        """Return the picture of a keyframe; None for another frame."""
        path = self._path(frame)
        return cv2.imread(str(path), cv2.IMREAD_UNCHANGED) if path.exists() else None

    def close(self) -> None:
        """Delete the pictures."""
        self._folder.cleanup()

    def recent(self) -> Flight:
        """Return the flight with the newest readings."""
        with self._lock:
            return self._with_readings(-_RECENT)

    def imu(self, begin_s: float, end_s: float) -> Imu | None:
        """Return the readings of the IMU between two times, and one before and after them; None without
        any."""
        with self._lock:
            imu = self._flight.imu
            if imu is None:
                before = sum(one.stamps_s[-1] < begin_s for one in self._imu)
                imu = _joined(self._imu[max(before - 1, 0) :])
        if imu is None:
            return None
        inside = np.flatnonzero((imu.stamps_s >= begin_s) & (imu.stamps_s <= end_s))
        if len(inside) == 0:
            return None
        rows = slice(max(int(inside[0]) - 1, 0), int(inside[-1]) + 2)
        return replace(
            imu,
            stamps_s=imu.stamps_s[rows],
            gyro_rad_s=imu.gyro_rad_s[rows],
            accel_m_s2=imu.accel_m_s2[rows],
        )

    def flight(self) -> Flight:
        """Return the flight with all readings, and with the frames that were given.

        If these are not the first ones of its own, it has the pictures of the keyframes alone, until `close`.
        """
        with self._lock:
            flight, stamps_s = self._with_readings(0), np.array(self._stamps_s)
            if flight.imu is None:
                flight = replace(flight, imu=_joined(self._imu))
        own, count = flight.frames, len(stamps_s)
        if own is not None and np.array_equal(own.stamps_s[:count], stamps_s):
            return replace(flight, frames=replace(own, stamps_s=stamps_s, names=own.names[:count]))
        names = tuple(f"{stamp_s:.3f} s" for stamp_s in stamps_s.tolist())
        return replace(flight, frames=Frames(stamps_s, names, self.picture))

    def _path(self, frame: int) -> Path:
        return Path(self._folder.name) / f"{frame:08d}.png"

    def _with_readings(self, begin: int) -> Flight:
        """Return the flight with the readings from number ``begin`` on, in place of streams it lacks."""
        flight = self._flight
        if flight.attitude is None and self._attitudes:
            stamps, angles = zip(*self._attitudes[begin:], strict=True)
            attitude = AttitudeSeries(np.array(stamps), np.array(angles), assumed=("noise_std",))
            flight = replace(flight, attitude=attitude)
        if flight.sonar is None and self._ranges:
            stamps, ranges = zip(*self._ranges[begin:], strict=True)
            # The limits of the instrument are not known here: whoever gives a range has judged it.
            unlimited = Sonar(np.array(stamps), np.array(ranges), min_range_m=0.0, max_range_m=np.inf)
            flight = replace(
                flight, sonar=replace(unlimited, assumed=("noise_std", "scale_std", "datum_std"))
            )
        return flight


def _joined(parts: Sequence[Imu]) -> Imu | None:
    """Return successive readings of one IMU as one series, with the noise and the mount of the first."""
    if not parts:
        return None
    stamps_s, gyro, accel = (
        np.concatenate([np.asarray(getattr(part, name), dtype=float) for part in parts])
        for name in ("stamps_s", "gyro_rad_s", "accel_m_s2")
    )
    return replace(parts[0], stamps_s=stamps_s, gyro_rad_s=gyro, accel_m_s2=accel)
