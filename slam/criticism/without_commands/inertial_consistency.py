"""Inertial consistency: comparison of instruments with the integrals of the imu, and the effect of each
error.

For any motion, tilt is the integral of the gyro, speed that of the accelerometer, and height the second
integral. The difference of reading and integral is averaged about moments half a second apart. Between these
it may change (twice, for the height) by noise alone, or by an effect. No equation of motion of the vehicle is
involved, so that pilot and wind do not matter.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from backend.measurements import GRAVITY_M_S2
from frontend.robust import robust_std
from slam.core.flight import Flight
from slam.core.rotations import rotation_of
from slam.criticism.search.thresholds import VERY_SIMILAR_NATS
from slam.criticism.without_commands.whitened_rows import (
    BETWEEN_SAMPLES,
    FEWEST,
    INTEGRATED,
    WhitenedRows,
    whitened_rows,
)
from slam.simulation.terms import CATALOGUE, Term

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

LOWEST_M = 0.35
"""Least height: nearer to the floor the vehicle may touch it, which shakes all instruments."""
JUMP = 6.0
"""Least jump of a rate between samples, beside its neighbours, in standard deviations."""
SMALL = 0.2
"""Size at which a term is undone for its derivative, as a share of its usual range: a delay of only some
milliseconds would show the noise of the attitude between two samples."""
DELAY = ".delay_s"
DELAYS_S = (-0.16, -0.08, 0.0, 0.08, 0.16, 0.24, 0.32)
"""Delays about which rows may be linear: a speed is averaged over 0.2 s, so rows are linear for half as
long either way."""
CERTAIN_NATS = 12.5
"""Least lead of a delay: half the square of five standard deviations, as for every effect."""
FAINT = 1e-9
"""Greatest entry of a column that is rounding."""


@dataclass(frozen=True)
class _Imu:
    """The imu of a flight, with the attitude at its stamps."""

    stamps_s: Array
    gyro: Array
    accel: Array
    angles: Array
    """(n, 3) roll, pitch, yaw."""
    w_R_b: Array
    """(n, 3, 3) the same as rotations."""

    @property
    def w_accel(self) -> Array:
        """(n, 3) specific force in the world."""
        return np.asarray(np.einsum("nij,nj->ni", self.w_R_b, self.accel))

    def integral(self, rate: Array) -> Array:
        """Return the integral (n, k) of a rate (n, k)."""
        step = np.diff(self.stamps_s)[:, None] * 0.5 * (rate[1:] + rate[:-1])
        return np.vstack([np.zeros(rate.shape[1]), np.cumsum(step, axis=0)])

    def at(self, times_s: Array, signal: Array) -> Array:
        """Return a signal (n, k) at other times, (m, k)."""
        return np.column_stack([np.interp(times_s, self.stamps_s, column) for column in signal.T])


@dataclass(frozen=True)
class IntegralComparison:
    """Readings of one kind and the integral of the imu, at the readings' own stamps."""

    stamps_s: Array
    read: Array
    """(n, components)."""
    integral: Array
    """(n, components)."""
    order: int
    """Number of integrations of the imu."""
    yaw: Array
    """(n,)."""
    others: Callable[[], dict[str, Array]] = dict
    """Return further columns (n, components), which belong to no term."""

    @property
    def off(self) -> Array:
        """Differences (n, components)."""
        return self.read - self.integral


def comparisons(flight: Flight) -> list[tuple[str, IntegralComparison]]:
    """Return every kind of comparison that the flight's streams allow."""
    flight = _with_finite_imu(flight)
    imu = _imu_of(flight)
    if imu is None:
        return []
    every = ((kind, compare(flight, imu)) for kind, compare in _COMPARISONS.items())
    return [(kind, seen) for kind, seen in every if seen is not None]


def inertial_residuals(flight: Flight) -> list[WhitenedRows]:
    """Return the rows of every comparison that the flight's streams allow."""
    finite = _with_finite_imu(flight)
    imu, low_s, found = _imu_of(finite), near_floor(flight), list[WhitenedRows]()
    if imu is None:
        return found
    for kind, seen in comparisons(finite):
        traces = _traces(finite, imu, kind, seen.off) | seen.others()
        late_s = _delay(finite, imu, kind, traces, low_s)
        if late_s != 0.0:
            late = replace(imu, stamps_s=imu.stamps_s + late_s)
            seen = _compared(finite, late, kind)
            traces = _traces(finite, late, kind, seen.off) | seen.others()
        rows = whitened_rows(kind, seen.stamps_s, seen.off, traces, low_s, seen.order)
        found += [r.shifted(READ_AS[kind] + DELAY, late_s) for r in rows]
    return found


def _delay(flight: Flight, imu: _Imu, kind: str, traces: dict[str, Array], low_s: Array) -> float:
    """Return the delay of a stream, of those on the grid, about which its rows are linear.

    Far from the truth the noise of the rows has the delay in it. Where their slope points to a delay, the
    profile likelihood is therefore compared, with the noise and all other errors fitted anew at each. Without
    motion slope and profile are chance: both must agree.
    """
    column = READ_AS[kind] + DELAY

    def rows(late_s: float) -> list[WhitenedRows]:
        seen = _compared(flight, replace(imu, stamps_s=imu.stamps_s + late_s), kind)
        return whitened_rows(kind, seen.stamps_s, seen.off, traces, low_s, seen.order)

    now = rows(0.0) if column in traces else []
    slope = sum(float(r.traces[column] @ r.off) for r in now)
    known = sum(float(r.traces[column] @ r.traces[column]) for r in now)
    if 0.5 * slope**2 <= VERY_SIMILAR_NATS * known:
        return 0.0
    nats = {late_s: sum(r.log_likelihood for r in rows(late_s)) for late_s in DELAYS_S if late_s * slope >= 0}
    best = max(nats, key=lambda late_s: nats[late_s])
    return best if nats[best] - nats[0.0] > CERTAIN_NATS else 0.0


def _compared(flight: Flight, imu: _Imu, kind: str) -> IntegralComparison:
    seen = _COMPARISONS[kind](flight, imu)
    assert seen is not None
    return seen


def _traces(flight: Flight, imu: _Imu, kind: str, off: Array) -> dict[str, Array]:
    """Return column -> (n, components) the change of the differences with each parameter of the terms.

    The catalogue's own corrections say how an error acts: the differences are compared with the term undone
    at a small size of either sign. A scale has two columns: by the quantity as read, and as integrated.
    """
    traces: dict[str, Array] = {}
    for term in CATALOGUE.values():
        if term.undo is None or not term.in_differences or term.stream not in ("imu", READ_AS[kind]):
            continue
        for k, parameter in enumerate(term.smooth):
            size = SMALL * (parameter.high - parameter.low)
            values = np.array([[p.neutral for p in term.parameters]] * 2)
            values[:, k] += -size, size
            less, more = (_off(term.undo(flight, v, None), imu, term, kind) for v in values)
            column = (less - more) / (2.0 * size)
            if np.abs(column).max() < FAINT:
                continue
            name = f"{term.name}.{parameter.name}"
            traces[name] = column
            if term.scales:
                other = column - off
                by_read, by_integral = (other, column) if term.stream == "imu" else (column, other)
                traces[name], traces[name + INTEGRATED] = by_read, by_integral
    return traces


def _off(undone: Flight, imu: _Imu, term: Term, kind: str) -> Array:
    """Return the differences (n, components) of a flight without a term; ``imu`` is that with the term."""
    changed = replace(imu, **_in_body_axes(undone)) if term.stream == "imu" else imu
    return _compared(undone, changed, kind).off


def _with_finite_imu(flight: Flight) -> Flight:
    """Return the flight without imu readings that are no numbers."""
    imu = flight.imu
    if imu is None:
        return flight
    kept = np.isfinite(imu.gyro_rad_s).all(axis=1) & np.isfinite(imu.accel_m_s2).all(axis=1)
    finite = replace(
        imu,
        stamps_s=imu.stamps_s[kept],
        gyro_rad_s=imu.gyro_rad_s[kept],
        accel_m_s2=imu.accel_m_s2[kept],
    )
    return replace(flight, imu=finite)


def _imu_of(flight: Flight) -> _Imu | None:
    """Return the imu in body axes where imu and attitude are known, else None."""
    if flight.imu is None or flight.attitude is None:
        return None
    angles = flight.attitude.roll_pitch_yaw_rad
    known = np.isfinite(angles).all(axis=1)
    if known.sum() < FEWEST or len(flight.imu.stamps_s) < FEWEST:
        return None
    turned, stamps = np.unwrap(angles[known], axis=0), flight.attitude.stamps_s[known]
    imu_s = flight.imu.stamps_s
    at_imu = np.column_stack([np.interp(imu_s, stamps, column) for column in turned.T])
    return _Imu(imu_s, **_in_body_axes(flight), angles=at_imu, w_R_b=rotation_of(at_imu))


def _in_body_axes(flight: Flight) -> dict[str, Array]:
    """Return the readings (n, 3) of the imu. A term of the imu changes them, and neither stamps nor
    attitude."""
    assert flight.imu is not None
    b_R_s = flight.imu.b_T_s[:3, :3]
    return {"gyro": flight.imu.gyro_rad_s @ b_R_s.T, "accel": flight.imu.accel_m_s2 @ b_R_s.T}


def _attitude(flight: Flight, imu: _Imu) -> IntegralComparison | None:
    assert flight.attitude is not None
    known = np.isfinite(flight.attitude.roll_pitch_yaw_rad).all(axis=1)
    stamps = flight.attitude.stamps_s[known]
    angles = np.unwrap(flight.attitude.roll_pitch_yaw_rad[known], axis=0)
    turn = np.einsum("nij,nj->ni", _angle_rates(imu.angles), imu.gyro)

    def others() -> dict[str, Array]:
        jumps = imu.at(stamps, _jumps(imu, turn))
        return {"attitude" + DELAY: -imu.at(stamps, turn), BETWEEN_SAMPLES: jumps}

    return IntegralComparison(stamps, angles, imu.at(stamps, imu.integral(turn)), 1, angles[:, 2], others)


def _jumps(imu: _Imu, rate: Array) -> Array:
    """Return (n, k) the sum of the jumps of a rate (n, k) so far, each times its sampling interval."""
    change = np.diff(rate, axis=0)
    apart = change - median_filter(change, (5, 1))
    apart[np.abs(apart) < JUMP * np.array([robust_std(a) for a in apart.T])] = 0.0
    worth = np.diff(imu.stamps_s)[:, None] * apart
    return np.vstack([np.zeros(rate.shape[1]), np.cumsum(worth, axis=0)])


def _velocity(flight: Flight, imu: _Imu) -> IntegralComparison | None:
    if flight.velocity is None:
        return None
    good = np.isfinite(flight.velocity.v_m_s).all(axis=1)
    stamps, read = flight.velocity.stamps_s[good], flight.velocity.v_m_s[good]
    if good.sum() < FEWEST:
        return None
    yaw = imu.at(stamps, imu.angles[:, 2:])[:, 0]
    speed = into_world(yaw, read)
    pull = _acceleration(imu)

    def others() -> dict[str, Array]:
        return {"velocity" + DELAY: -imu.at(stamps, imu.w_accel)[:, :2]}

    return IntegralComparison(stamps, speed, imu.at(stamps, imu.integral(pull))[:, :2], 1, yaw, others)


def _height(flight: Flight, imu: _Imu) -> IntegralComparison | None:
    if flight.sonar is None:
        return None
    good = np.isfinite(flight.sonar.range_m)
    stamps, read = flight.sonar.stamps_s[good], flight.sonar.range_m[good]
    if good.sum() < FEWEST:
        return None
    angles = imu.at(stamps, imu.angles)
    up = rotation_of(angles)[:, 2]
    height = read * (up @ flight.sonar.b_T_s[:3, 2])
    risen = imu.at(stamps, imu.integral(imu.integral(_acceleration(imu))[:, 2:]))
    return IntegralComparison(stamps, height[:, None], risen, 2, angles[:, 2])


_COMPARISONS = {"attitude": _attitude, "velocity": _velocity, "height": _height}
READ_AS = {"attitude": "attitude", "velocity": "velocity", "height": "sonar"}
"""Kind -> stream that is compared with the imu."""


def _acceleration(imu: _Imu) -> Array:
    """Return (n, 3) acceleration in the world."""
    return np.asarray(imu.w_accel - [0.0, 0.0, GRAVITY_M_S2])


def near_floor(flight: Flight) -> Array:
    """Return stamps of ranges that are missing, or so small that the vehicle may stand."""
    if flight.sonar is None:
        return np.zeros(0)
    near = ~(flight.sonar.range_m > LOWEST_M)
    return flight.sonar.stamps_s[near]


def into_world(yaw: Array, ahead_left: Array) -> Array:
    """Return (n, 2) east and north of a velocity ahead and to the left."""
    c, s = np.cos(yaw), np.sin(yaw)
    x, y = ahead_left.T
    return np.column_stack([c * x - s * y, s * x + c * y])


def _angle_rates(angles: Array) -> Array:
    """Return (n, 3, 3) matrices from body rates to rates of roll, pitch and yaw."""
    (sr, cr), pitch = (np.sin(angles[:, 0]), np.cos(angles[:, 0])), angles[:, 1]
    zero, one = np.zeros(len(pitch)), np.ones(len(pitch))
    rows = [
        [one, sr * np.tan(pitch), cr * np.tan(pitch)],
        [zero, cr, -sr],
        [zero, sr / np.cos(pitch), cr / np.cos(pitch)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
