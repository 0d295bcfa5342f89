"""Inertial consistency: comparison of instruments with the integrals of the imu, and the effect of each
error.

For any motion, tilt is the integral of the gyro, speed that of the accelerometer, and height the second
integral. The difference of reading and integral is averaged about moments half a second apart. Between these
it may change (twice, for the height) by noise alone, or by an effect. No equation of motion of the vehicle is
involved, so that pilot and wind do not matter.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.ndimage import median_filter

from backend.measurements import GRAVITY_M_S2
from frontend.robust import robust_std
from slam.core.flight import Flight
from slam.core.rotations import rotation_of

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

NODE_S, ABOUT_S = 0.5, 0.1
"""Spacing of the moments, and half the time about each over which differences are averaged."""
LONGEST_GAP_S = 0.15
LOWEST_M = 0.35
"""Least height: nearer to the floor the vehicle may touch it, which shakes all instruments."""
FEWEST = 20
INTEGRATED = " as integrated"
"""Suffix of the second estimate of the quantity that a scale multiplies."""
CHANNELS = {
    "attitude": [(f"{angle} from the gyro", "rad") for angle in ("roll", "pitch", "yaw")],
    "velocity": [(f"velocity {way} from the accelerometer", "m/s") for way in ("east", "north")],
    "height": [("height from the accelerometer", "m")],
}
"""Name and unit of each component of a comparison."""
LEAST_SHARE = 0.05
BETWEEN_SAMPLES = "gyro between samples"
"""Column of the effect of jumps of the rate between samples. The moment between the samples is unknown. Where
sticks jump at even times it is always the same."""
JUMP = 6.0
"""Least jump of a rate between samples, beside its neighbours, in standard deviations."""
FAR_OFF = 5.0


@dataclass(frozen=True)
class Averages:
    """One component of a comparison, at moments ``NODE_S`` apart."""

    channel: str
    unit: str
    order: int
    """Number of integrations of the imu."""
    times_s: Array
    """(n,)."""
    whole: NDArray[np.bool_]
    """(n,) whether there are readings about a moment, none of them near the floor."""
    pause: Ints
    """(n,) number of gaps before the moment."""
    names: list[str]
    """Names of the table's columns after its first."""
    table: Array
    """(n, 1 + columns) reading less integral, and its derivative by each effect."""

    def knows(self, name: str) -> bool:
        """Whether a column of an effect changes it."""
        return name in self.names

    def column(self, name: str) -> int:
        """Return the index of a column in the table; of a scale, that of the integrated quantity."""
        return 1 + self.names.index(name + INTEGRATED if name + INTEGRATED in self.names else name)


@dataclass(frozen=True)
class WhitenedRows:
    """Differences of unit variance, and their derivatives by each effect."""

    kind: str
    """``attitude``, ``velocity`` or ``height``, compared with the imu; or ``pictures``, compared with all."""
    times_s: Array
    """(n,)."""
    off: Array
    """(n,)."""
    traces: dict[str, Array]
    """Column -> (n,)."""
    noise: float
    """Standard deviation by which a difference was divided; rad, m/s or m. For pictures it is in units of
    their own noise."""
    averages: Averages | None
    """Averages that they are differences of; None for pictures."""


@dataclass(frozen=True)
class _Imu:
    """The imu of a flight, with the attitude at its stamps."""

    stamps_s: Array
    gyro: Array
    accel: Array
    angles: Array
    """(n, 3) roll, pitch, yaw."""

    def integral(self, rate: Array) -> Array:
        """Return the integral (n, k) of a rate (n, k)."""
        step = np.diff(self.stamps_s)[:, None] * 0.5 * (rate[1:] + rate[:-1])
        return np.vstack([np.zeros(rate.shape[1]), np.cumsum(step, axis=0)])

    def at(self, times_s: Array, signal: Array) -> Array:
        """Return a signal (n, k) at other times, (m, k)."""
        return np.column_stack([np.interp(times_s, self.stamps_s, column) for column in signal.T])


def inertial_residuals(flight: Flight) -> list[WhitenedRows]:
    """Return the rows of every comparison that the flight's streams allow."""
    if flight.imu is None or flight.attitude is None:
        return []
    angles = flight.attitude.roll_pitch_yaw_rad
    known = np.isfinite(angles).all(axis=1)
    finite = np.isfinite(flight.imu.gyro_rad_s).all(axis=1) & np.isfinite(flight.imu.accel_m_s2).all(axis=1)
    if known.sum() < FEWEST or finite.sum() < FEWEST:
        return []
    turned, stamps = np.unwrap(angles[known], axis=0), flight.attitude.stamps_s[known]
    b_R_s = flight.imu.b_T_s[:3, :3]
    imu_s = flight.imu.stamps_s[finite]
    at_imu = np.column_stack([np.interp(imu_s, stamps, column) for column in turned.T])
    gyro, accel = flight.imu.gyro_rad_s[finite] @ b_R_s.T, flight.imu.accel_m_s2[finite] @ b_R_s.T
    imu = _Imu(imu_s, gyro, accel, at_imu)
    low_s = near_floor(flight)
    found = _attitude(imu, stamps, turned, low_s)
    if flight.velocity is not None:
        found += _velocity(imu, flight, low_s)
    if flight.sonar is not None:
        found += _height(imu, flight, low_s)
    return found


def _attitude(imu: _Imu, stamps: Array, angles: Array, near_floor: Array) -> list[WhitenedRows]:
    rates = _angle_rates(imu.angles)
    eye = np.eye(3)
    turn = np.einsum("nij,nj->ni", rates, imu.gyro)
    columns = {f"gyro_bias.{a}": -imu.integral(rates[:, :, j]) for j, a in enumerate("xyz")}
    columns["gyro_scale.eps"] = -imu.integral(turn)
    for j, axis in enumerate("xyz"):
        crossed = np.einsum("nij,nj->ni", rates, np.cross(eye[j], imu.gyro))
        columns[f"imu_misalignment.{axis}"] = imu.integral(crossed)
    columns["attitude late.s"] = -turn
    columns[BETWEEN_SAMPLES] = _jumps(imu, turn)
    traces = {name: imu.at(stamps, column) for name, column in columns.items()}
    off = angles - imu.at(stamps, imu.integral(turn))
    _as_read(traces, "gyro_scale.eps", off)
    return _rows("attitude", stamps, off, traces, near_floor, 1)


def _jumps(imu: _Imu, rate: Array) -> Array:
    """Return (n, k) the sum of the jumps of a rate (n, k) so far, each times its sampling interval."""
    change = np.diff(rate, axis=0)
    apart = change - median_filter(change, (5, 1))
    apart[np.abs(apart) < JUMP * np.array([robust_std(a) for a in apart.T])] = 0.0
    worth = np.diff(imu.stamps_s)[:, None] * apart
    return np.vstack([np.zeros(rate.shape[1]), np.cumsum(worth, axis=0)])


def _velocity(imu: _Imu, flight: Flight, near_floor: Array) -> list[WhitenedRows]:
    assert flight.velocity is not None
    good = np.isfinite(flight.velocity.v_m_s).all(axis=1)
    stamps, read = flight.velocity.stamps_s[good], flight.velocity.v_m_s[good]
    if good.sum() < FEWEST:
        return []
    yaw = imu.at(stamps, imu.angles[:, 2:])[:, 0]
    speed = _into_world(yaw, read)
    columns = _of_accel(imu)
    columns["velocity late.s"] = -np.einsum("nij,nj->ni", rotation_of(imu.angles), imu.accel)
    traces = {name: imu.at(stamps, column)[:, :2] for name, column in columns.items()}
    integrated = imu.integral(_acceleration(imu))
    traces["flow_scale.eps"], traces["flow_scale.eps" + INTEGRATED] = speed, imu.at(stamps, integrated)[:, :2]
    if flight.sonar is not None and np.isfinite(flight.sonar.range_m).sum() >= FEWEST:
        known = np.isfinite(flight.sonar.range_m)
        height = np.interp(stamps, flight.sonar.stamps_s[known], flight.sonar.range_m[known])
        gyro = imu.at(stamps, imu.gyro)
        traces["flow_derotation.kappa"] = _into_world(yaw, height[:, None] * gyro[:, [1, 0]] * [1.0, -1.0])
    off = speed - imu.at(stamps, integrated)[:, :2]
    _as_read(traces, "accel_scale.eps", off)
    return _rows("velocity", stamps, off, traces, near_floor, 1)


def _height(imu: _Imu, flight: Flight, near_floor: Array) -> list[WhitenedRows]:
    assert flight.sonar is not None
    good = np.isfinite(flight.sonar.range_m)
    stamps, read = flight.sonar.stamps_s[good], flight.sonar.range_m[good]
    if good.sum() < FEWEST:
        return []
    roll, pitch, _ = imu.at(stamps, imu.angles).T
    level = np.cos(roll) * np.cos(pitch)
    height = read * level
    columns = {name: imu.integral(column) for name, column in _of_accel(imu).items()}
    traces = {name: imu.at(stamps, column)[:, 2:] for name, column in columns.items()}
    climb = imu.integral(_acceleration(imu))[:, 2:]
    risen = imu.at(stamps, imu.integral(climb))
    traces["sonar_scale.eps"], traces["sonar_scale.eps" + INTEGRATED] = height[:, None], risen
    traces["sonar_lag.T"] = -imu.at(stamps, climb)
    traces["sonar_slant.c"] = (height * (1.0 - level))[:, None]
    traces["sonar_tilt.y"] = (height * np.sin(pitch) / level)[:, None]
    traces["sonar_tilt.x"] = (height * np.cos(pitch) * np.sin(roll) / level)[:, None]
    off = height[:, None] - risen
    _as_read(traces, "accel_scale.eps", off)
    return _rows("height", stamps, off, traces, near_floor, 2)


def _as_read(traces: dict[str, Array], name: str, off: Array) -> None:
    """Add the estimate from the reading for a scale of the integral."""
    traces[name + INTEGRATED] = traces[name]
    traces[name] = traces[name] - off


def _of_accel(imu: _Imu) -> dict[str, Array]:
    """Return columns of the accelerometer in the integrated speed, (n, 3) each."""
    R, eye = rotation_of(imu.angles), np.eye(3)
    found = {f"accel_bias.{a}": -imu.integral(R[:, :, j]) for j, a in enumerate("xyz")}
    found["accel_scale.eps"] = -imu.integral(np.einsum("nij,nj->ni", R, imu.accel))
    for j, axis in enumerate("xyz"):
        crossed = np.einsum("nij,nj->ni", R, np.cross(eye[j], imu.accel))
        found[f"imu_misalignment.{axis}"] = imu.integral(crossed)
    return found


def _acceleration(imu: _Imu) -> Array:
    """Return (n, 3) acceleration in the world."""
    return np.asarray(np.einsum("nij,nj->ni", rotation_of(imu.angles), imu.accel) - [0.0, 0.0, GRAVITY_M_S2])


def _rows(
    kind: str, stamps: Array, off: Array, traces: dict[str, Array], near_floor: Array, order: int
) -> list[WhitenedRows]:
    """Return one set of whitened rows for each component of ``off`` (n, components)."""
    nodes = np.arange(stamps[0] + ABOUT_S, stamps[-1] - ABOUT_S, NODE_S)
    begin = np.searchsorted(stamps, nodes - ABOUT_S)
    end = np.searchsorted(stamps, nodes + ABOUT_S)
    far = np.diff(stamps, append=np.inf) > LONGEST_GAP_S
    gaps = np.concatenate([[0], np.cumsum(far)])
    low = np.searchsorted(near_floor, nodes + 2 * ABOUT_S) - np.searchsorted(near_floor, nodes - 2 * ABOUT_S)
    whole = (end - begin >= 2) & (low == 0)
    late = np.concatenate([[0.0], np.cumsum(stamps)])
    count = np.maximum(end - begin, 1)
    late = np.where(end > begin, (late[end] - late[begin]) / count - nodes, 0.0)
    made = []
    for c in range(off.shape[1]):
        table = np.column_stack([off[:, c], *(t[:, c] for t in traces.values())])
        total = np.vstack([np.zeros(table.shape[1]), np.cumsum(table - table.mean(axis=0), axis=0)])
        means = (total[end] - total[begin]) / count[:, None]
        # A double integral drifts: a delayed reading would show the drift, and not the motion.
        means -= late[:, None] * np.gradient(means, nodes + late, axis=0)
        pause = gaps[np.minimum(begin, len(stamps) - 1)]
        averages = Averages(*CHANNELS[kind][c], order, nodes, whole, pause, list(traces), means)
        steps = np.diff(means, n=order, axis=0)
        kept = np.all([whole[k : len(whole) - order + k] for k in range(order + 1)], axis=0)
        kept &= gaps[end[order:] - 1] == gaps[begin[: len(begin) - order]]
        if kept.sum() >= FEWEST:
            made.append(_white(kind, nodes[order:][kept], np.flatnonzero(kept), steps[kept], averages))
    return made


def _white(kind: str, times_s: Array, place: Ints, table: Array, averages: Averages) -> WhitenedRows:
    """Whiten the rows by their own scatter, which is that of the averages and that of the integral."""
    names = averages.names
    left = np.clip(table[:, 0], *np.quantile(table[:, 0], [0.02, 0.98]))
    near = np.diff(place) == 1
    variance, next_one = float(np.mean(left**2)), float(np.mean((left[1:] * left[:-1])[near]))
    shape = np.array([2.0, -1.0]) if averages.order == 1 else np.array([6.0, -4.0, 1.0])
    of_ends = float(np.clip(next_one / shape[1], 0.0, (1 - LEAST_SHARE) * variance / shape[0]))
    # Reading and integral both contain noise that is in the difference too; their weighted mean does not.
    # Where there is little else in them, they are no evidence for a scale.
    read = shape[0] * of_ends / variance
    for k in [k for k, name in enumerate(names) if name + INTEGRATED in names]:
        beside = names.index(names[k] + INTEGRATED)
        moves = float(np.mean(table[:, 1 + k] * table[:, 1 + beside])) > variance
        both = (1.0 - read) * table[:, 1 + k] + read * table[:, 1 + beside]
        table[:, 1 + k] = both if moves else 0.0
    apart = np.abs(place[:, None] - place)
    banded = np.append(of_ends * shape, 0.0)[np.minimum(apart, len(shape))]
    banded[np.diag_indices(len(banded))] += variance - shape[0] * of_ends
    if BETWEEN_SAMPLES in names:
        between = table[:, 1 + names.index(BETWEEN_SAMPLES)]
        banded += np.outer(between, between) / 12.0
    white = solve_triangular(np.linalg.cholesky(banded), table, lower=True)
    # Effects are no scatter, and no reason to leave rows out.
    mixed = [n for n in names if n + INTEGRATED in names or n.endswith(INTEGRATED)]
    own = [1 + k for k, n in enumerate(names) if n not in (*mixed, BETWEEN_SAMPLES)]
    size = np.linalg.lstsq(white[:, own], white[:, 0], rcond=1e-6)[0]
    left = white[:, 0] - white[:, own] @ size
    far = np.abs(left) > FAR_OFF * robust_std(left)
    free = max(int(np.sum(~far)) - len(size), 1)
    scatter = max(float(np.sqrt(np.sum(left[~far] ** 2) / free)), 1e-9)
    white /= scatter
    white[far] = 0.0
    effects = [n for n in names if not n.endswith(INTEGRATED) and n != BETWEEN_SAMPLES]
    traces = {n: white[:, 1 + names.index(n)] for n in effects}
    return WhitenedRows(kind, times_s, white[:, 0], traces, scatter * float(np.sqrt(variance)), averages)


def near_floor(flight: Flight) -> Array:
    """Return stamps of ranges that are missing, or so small that the vehicle may stand."""
    if flight.sonar is None:
        return np.zeros(0)
    near = ~(flight.sonar.range_m > LOWEST_M)
    return flight.sonar.stamps_s[near]


def _into_world(yaw: Array, ahead_left: Array) -> Array:
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
