"""Measurements that the back end accepts, as frozen dataclasses over numpy.

Conventions, defined only here:

* ``a_T_b`` is a (4, 4) rigid transform that takes coordinates in b to coordinates in a.
* Covariances of poses are 6x6, **rotation first** (rad, then m), of a right perturbation in body
  axes: ``w_T_b = w_T_b_hat Exp(xi)`` with ``xi = (rotation, translation)``. This is gtsam's order.
* World ``w``: z up, the mean floor at ``z = floor_z`` (0 by default).
  Body ``b``: x forward, y left, z up.
* Keyframes are numbered 0..n-1 in order of time; every measurement names them by that number.

The package imports numpy alone, so that the front end can use it without the rest of the back end. It also
says why a link between keyframes is rejected, which both do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from backend.measurements.at_keyframes import (
    Attitude,
    BarometerHeight,
    ControlPoint,
    EdgeKind,
    Position,
    RelativePose,
    SlantRange,
)
from backend.measurements.motion import (
    GRAVITY_M_S2,
    NO_REPORTED_NOISE,
    Inertial,
    InertialNoise,
    InertialReadings,
    ReportedMotion,
    ReportedNoise,
)
from backend.measurements.pictures import (
    AlignedPair,
    FloorTracks,
    LensModel,
    PinholeModel,
    RowExposure,
    TrackedFrame,
)
from backend.measurements.rejection import (
    CONTRADICTED,
    SAME_PLACE_HEIGHTS,
    UNPROVEN,
    LinkCheck,
    Misfit,
    Rejection,
)

__all__ = [
    "CONTRADICTED",
    "GRAVITY_M_S2",
    "NO_REPORTED_NOISE",
    "SAME_PLACE_HEIGHTS",
    "UNPROVEN",
    "AlignedPair",
    "Attitude",
    "BarometerHeight",
    "ControlPoint",
    "EdgeKind",
    "FloorTracks",
    "Inertial",
    "InertialNoise",
    "InertialReadings",
    "LensModel",
    "LinkCheck",
    "Measurements",
    "Misfit",
    "PinholeModel",
    "Position",
    "Rejection",
    "RelativePose",
    "ReportedMotion",
    "ReportedNoise",
    "RowExposure",
    "SlantRange",
    "TrackedFrame",
]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Measurements:
    """All measurements of a flight's keyframes: the input of the back end."""

    stamps_s: Array
    """(n,) times of the keyframes on the flight's clock."""
    relative_poses: tuple[RelativePose, ...] = ()
    attitudes: tuple[Attitude, ...] = ()
    ranges: tuple[SlantRange, ...] = ()
    positions: tuple[Position, ...] = ()
    heights: tuple[BarometerHeight, ...] = ()
    control: tuple[ControlPoint, ...] = ()
    tracks: FloorTracks | None = None
    camera: PinholeModel | None = None
    inertial: Inertial | None = None
    reported: ReportedMotion | None = None
    frames: tuple[TrackedFrame, ...] = ()
    """Pictures between keyframes at which motion by instruments is compared, in order of time."""
    aligned: tuple[AlignedPair, ...] = ()
    range_gain_std: float = 0.05
    """Relative standard deviation of the scale error that all ranges share (temperature, calibration)."""
    range_datum_std_m: float = 0.02
    """Standard deviation of the zero offset that all ranges share."""
    antenna_m: Array = field(default_factory=lambda: np.zeros(3))
    """(3,) point of the body that ``positions`` belong to."""
    antenna_std_m: float = 0.0
    """Its standard deviation along each body axis; 0 holds it."""
    antenna_up_std_m: float = 0.0
    """Least standard deviation along the body's up axis alone."""
    names: tuple[str, ...] = field(default=())
    """Name of each keyframe in messages; empty: its number."""
    exposure: RowExposure | None = None
    """How the rows of photographs are exposed; None where the features have been moved to one moment."""
    length_unit: str = "m"
    """Name of the unit of all lengths in messages. Without a metric measurement it is another one."""

    @property
    def count(self) -> int:
        """Number of keyframes."""
        return len(self.stamps_s)

    @property
    def placed(self) -> bool:
        """Whether positions or control points place the map in the world."""
        return bool(self.positions or self.control)

    @property
    def antenna_is_free(self) -> bool:
        """Whether the place of the antenna, or its height alone, is a variable."""
        return bool(self.positions) and max(self.antenna_std_m, self.antenna_up_std_m) > 0

    @property
    def axes_of_both(self) -> NDArray[np.bool_]:
        """(3,) axes along which positions and control points are measured, so that they can be compared."""
        both = [[one.std_m for one in of] for of in (self.positions, self.control)]
        known = [np.isfinite(np.reshape(stds, (-1, 3))).any(axis=0) for stds in both]
        return np.asarray(known[0] & known[1])

    def of_keyframes(self, members: Sequence[int]) -> Measurements:
        """Return the measurements of some keyframes alone, numbered in the order of ``members`` (m,).

        What names another keyframe is left out. Inertial readings and reported motion belong to no keyframe
        and stay.
        """
        number = {k: place for place, k in enumerate(members)}
        return replace(
            self,
            stamps_s=self.stamps_s[list(members)],
            relative_poses=tuple(
                replace(e, i=number[e.i], j=number[e.j])
                for e in self.relative_poses
                if e.i in number and e.j in number
            ),
            tracks=None if self.tracks is None else self.tracks.of_keyframes(members, self.count),
            names=tuple(self.names[k] for k in members) if self.names else (),
            exposure=self.exposure.of_keyframes(members) if self.exposure else None,
            attitudes=tuple(replace(a, k=number[a.k]) for a in self.attitudes if a.k in number),
            ranges=tuple(replace(r, k=number[r.k]) for r in self.ranges if r.k in number),
            positions=tuple(replace(p, k=number[p.k]) for p in self.positions if p.k in number),
            heights=tuple(replace(h, k=number[h.k]) for h in self.heights if h.k in number),
            control=tuple(c for c in (c.of_keyframes(number) for c in self.control) if len(c.keyframe)),
            aligned=tuple(a.renumbered(number) for a in self.aligned if set(a.keyframes) <= number.keys()),
            frames=tuple(replace(f, k=number[f.k]) for f in self.frames if f.k in number),
        )
