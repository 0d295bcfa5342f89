"""The map that an export writes: its placed keyframes in the frames and units that other programs use."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from backend.se3 import adjoint, inverse
from slam.core.errors import InputError, one_line
from slam.core.estimate import Estimate
from slam.core.flight import Flight
from slam.core.geodesy import geodetic_from_enu
from slam.core.height_systems import height_system_text
from slam.core.names import listed
from slam.core.progress import Progress, silent
from slam.io.gps_heights import is_ellipsoidal

Array = NDArray[np.float64]

_FIRST_CALENDAR_NS = 315_964_800 * 10**9
"""6 January 1980, the first day of GPS time. Earlier stamps count from the start of a recorder."""
_UNIX_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


@dataclass(frozen=True, kw_only=True)
class Keyframes:
    """Placed keyframes in order of time, in one common frame."""

    numbers: NDArray[np.int64]
    """(n,) numbers of the keyframes in the estimate."""
    names: tuple[str, ...]
    """Names of the pictures, or numbers where there are none; printable, on one line."""
    stamps_ns: NDArray[np.int64]
    w_T_b: Array
    """(n, 4, 4) poses of the body, or of a sensor after ``of_sensor``."""
    covariances: Array
    """(n, 6, 6), rotation first, right perturbation; NaN where unknown."""
    component: NDArray[np.int64]
    """(n,) part of the map; pictures connect the keyframes of a part."""

    def __len__(self) -> int:
        return len(self.names)

    def with_plain_names(self, reader: str) -> tuple[Keyframes, tuple[str, ...]]:
        """Return the keyframes whose names are one word, and a note about the others.

        Raises ``InputError`` if no name is one word.
        """
        keep = [k for k, name in enumerate(self.names) if name.split() == [name] and not name.startswith("#")]
        if len(keep) == len(self):
            return self, ()
        if not keep:
            what = f"{reader} reads a name up to its first space, and every picture has a space in its name"
            raise InputError(f"{what}; rename the pictures and map them again")
        others = [name for k, name in enumerate(self.names) if k not in set(keep)]
        plain = replace(
            self,
            numbers=self.numbers[keep],
            names=tuple(self.names[k] for k in keep),
            stamps_ns=self.stamps_ns[keep],
            w_T_b=self.w_T_b[keep],
            covariances=self.covariances[keep],
            component=self.component[keep],
        )
        what = f"{len(others)} pictures left out: {reader} reads a name up to its first space"
        return plain, (f"{what} ({listed(others)})",)

    def in_one_folder(self) -> Keyframes:
        """Return the keyframes with names for one folder: pictures of several flights have the flight's name
        before their own, with ``_`` between."""
        return replace(self, names=tuple(name.replace("/", "_") for name in self.names))

    def of_sensor(self, b_T_s: Array) -> Keyframes:
        """Return the poses and covariances of a sensor that is mounted on the body."""
        change = adjoint(inverse(b_T_s))
        return replace(self, w_T_b=self.w_T_b @ b_T_s, covariances=change @ self.covariances @ change.T)

    @property
    def position_stds_m(self) -> Array:
        """(n, 3) standard deviations of the positions along the axes of the world; NaN where unknown."""
        R = self.w_T_b[:, :3, :3]
        variance = np.einsum("nij,njk,nik->ni", R, self.covariances[:, 3:, 3:], R)
        return np.sqrt(np.where(variance >= 0, variance, np.nan))

    @property
    def fixed_axes_covariances(self) -> Array:
        """(n, 6, 6) covariances in ROS's order, translation first, along the axes of the world.

        Source: the comment of ``geometry_msgs/PoseWithCovariance``.
        """
        R = self.w_T_b[:, :3, :3]
        change = np.zeros((len(R), 6, 6))
        change[:, :3, 3:] = change[:, 3:, :3] = R
        return np.asarray(change @ self.covariances @ change.transpose(0, 2, 1))

    @property
    def has_calendar_time(self) -> bool:
        """Whether the stamps count from 1970, and not from the start of a recorder."""
        return bool((self.stamps_ns >= _FIRST_CALENDAR_NS).all())

    def utc(self, k: int) -> str:
        """Return the time of keyframe k in ISO 8601 with microseconds, its stamp taken as UTC."""
        time = _UNIX_EPOCH + timedelta(microseconds=int(self.stamps_ns[k]) // 1000)
        return time.strftime("%Y-%m-%dT%H:%M:%S.%fZ")

    def parts(self) -> Iterator[NDArray[np.int64]]:
        """Yield the indices of keyframes that follow each other in one part of the map."""
        breaks = np.flatnonzero(np.diff(self.component)) + 1
        yield from np.split(np.arange(len(self)), breaks)


@dataclass(frozen=True)
class ExportedMap:
    """A map, and what an export may need beside it."""

    estimate: Estimate
    photos: Path | None = None
    """Folder of the photographs that the map was made of."""
    progress: Progress = silent
    folder: Path | None = None
    """Output folder of the map, for its rasters."""
    crs: str = "utm"
    """Coordinate system of the rasters: ``utm``, or ``EPSG:`` and a number."""
    flight: Flight | None = None
    """The flight that the map was made of, for its pictures."""

    @property
    def name(self) -> str:
        """The name of the flight on one printable line."""
        return one_line(self.estimate.name)

    @cached_property
    def keyframes(self) -> Keyframes:
        """Placed keyframes, of a map without a place on Earth those of the largest part.

        Without a place on Earth, the parts of a map have no common frame.
        """
        estimate = self.estimate
        is_common = (estimate.component == 0) | (estimate.origin is not None)
        chosen = np.flatnonzero(estimate.placed & is_common)
        return Keyframes(
            numbers=chosen,
            names=tuple(one_line(estimate.frame_names[k]) for k in chosen),
            stamps_ns=estimate.stamps_ns[chosen],
            w_T_b=estimate.w_T_b[chosen],
            covariances=estimate.covariances[chosen],
            component=estimate.component[chosen],
        )

    def geodetic(self, frames: Keyframes) -> tuple[Array, Array, Array]:
        """Return latitudes [deg], longitudes [deg] and altitudes [m] of poses of the map, each (n,).

        Altitudes are NaN where nothing tells how high the map lies. The map has a place on Earth.
        """
        assert self.estimate.origin is not None
        latitude, longitude, altitude = geodetic_from_enu(frames.w_T_b[:, :3, 3], self.estimate.origin)
        known = self.estimate.altitude_known
        return latitude, longitude, altitude if known else np.full(len(altitude), np.nan)

    def navigation_fixes(self, frames: Keyframes) -> tuple[Array, Array, Array]:
        """Return the same for fixes of satellite navigation, whose altitudes count from the ellipsoid.

        Altitudes of another vertical datum are NaN. Those of an unknown datum are written as recorded.
        """
        latitude, longitude, altitude = self.geodetic(frames)
        return latitude, longitude, np.full(len(altitude), np.nan) if self.is_above_sea_level else altitude

    @cached_property
    def is_above_sea_level(self) -> bool:
        """Whether the altitudes are known to count from another surface than the ellipsoid."""
        system = self.estimate.height_system
        return bool(system) and not is_ellipsoidal(system)

    def navigation_notes(self) -> tuple[str, ...]:
        """Return why fixes of satellite navigation have no altitude."""
        if self.estimate.origin is None or not self.is_above_sea_level:
            return ()
        system = height_system_text(self.estimate.height_system)
        return (
            "/slam/fix has no altitudes: it takes heights over the ellipsoid, and those of the map count "
            f"from {system}",
        )

    @property
    def heights_above_floor_m(self) -> Array:
        """(n,) heights of the keyframes above the floor of the map."""
        estimate = self.estimate
        return np.asarray(estimate.over_floor_T_b[self.keyframes.numbers, 2, 3] - estimate.floor_z_m)

    @property
    def description(self) -> str:
        """One line about the map for formats that hold text."""
        status = "" if self.estimate.status == "ok" else f"; {one_line(self.estimate.status)}"
        return f"{len(self.keyframes)} keyframes estimated by slam{status}"

    def notes(self) -> tuple[str, ...]:
        """Return one line for everything that limits the use of the exported map."""
        estimate, lines = self.estimate, []
        if estimate.status != "ok":
            lines.append(f"the map's status is: {estimate.status}")
        left_out = len(estimate.stamps_s) - len(self.keyframes)
        if left_out:
            lines.append(
                f"{left_out} of {len(estimate.stamps_s)} keyframes are not placed in the common frame"
            )
        if not estimate.metric:
            lines.append("lengths are in mean heights of the camera, not in metres")
        if estimate.origin is not None and not estimate.altitude_known:
            lines.append("no altitude is recorded: heights count from the floor, and are no altitudes")
        return tuple(lines)
