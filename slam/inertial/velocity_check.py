"""Changes of the measured velocity against those by gyro and accelerometer.

The filter accepts a velocity that is stuck, reversed or in another unit, because nothing else measures the
motion over ground. It attributes the error to the tilt and the other instruments. Over a second or two, the
IMU alone determines the changes of velocity.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.spatial.transform import Rotation

from backend.measurements import GRAVITY_M_S2
from backend.preintegration.integrals import gaps
from backend.significance import SURE_SIGMAS
from slam.core.messages import Message, warning
from slam.core.rotations import roll_pitch_yaw_of, rotation_of
from slam.core.streams import Imu
from slam.inertial.filter_input import filter_input
from slam.inertial.instruments import InertialTrust
from slam.inertial.motion import filter_motion
from slam.inertial.variogram import white_density

if TYPE_CHECKING:
    from slam.core.flight import Flight
    from slam.core.streams import AttitudeSeries

Array = NDArray[np.float64]

_STEP_S, _WINDOW_S = 0.05, 2.0
"""Velocities are compared every step after their mean over the window is subtracted: errors of tilt and
accelerometer add up more slowly."""
_PARTS, _SURE_IN_PARTS = (2, 4), 4.0
"""Numbers of parts that are looked at alone, and the standard deviations that their six comparisons need."""
_SURE_OF_ZERO = 4.0
"""Standard deviations that an error of the velocity's zero needs; healthy measured flights have up to 3.3."""
_ABOVE_NOISE, _FAR_ABOVE_NOISE = 2.0, 3.0
"""Multiples of the accelerometer's integrated noise that the vehicle's changes of velocity must exceed; the
larger one where nothing but a lack of correlation speaks against the velocity."""
_DOUBT = "the track over ground is not to be trusted"
_CHECK = "check signs, axes, unit and stamps of velocity0"
_LEAST_COSINE = 0.5
"""Cosine of 60 deg, the largest tilt at which a thrust is thought to carry the vehicle."""
_AXES: Mapping[str, Array] = {
    "": np.eye(2),
    "forward and left exchanged": np.array([[0.0, 1.0], [1.0, 0.0]]),
    "forward turned round": np.diag([-1.0, 1.0]),
    "left turned round": np.diag([1.0, -1.0]),
    "both axes turned round": -np.eye(2),
    "a quarter turn to the left": np.array([[0.0, 1.0], [-1.0, 0.0]]),
    "a quarter turn to the right": np.array([[0.0, -1.0], [1.0, 0.0]]),
    "forward and left exchanged and turned round": np.array([[0.0, -1.0], [-1.0, 0.0]]),
}
"""Mistakes in the axes: the matrix by which a velocity (n, 2), forward and left, is multiplied."""
LARGEST_GAIN = 2.0
"""Largest ratio of two changes that noise and gains explain; another unit differs by 3.28 (feet) at least."""


def velocity_contradiction(flight: Flight, trust: InertialTrust = InertialTrust()) -> Message | None:
    """Describe how the velocity contradicts gyro and accelerometer; None where it does not.

    Without an IMU the attitude is in its place: a multirotor is pushed to where it leans. Other vehicles are
    not, so that nothing is said unless other axes agree. Raises ``InputError`` where the flight has too
    little without its velocity.
    """
    witness = "imu0" if flight.imu is not None else "attitude0"
    imu, velocity = flight.imu or _imu_by_lean(flight.attitude), flight.velocity
    if imu is None or velocity is None or len(imu.stamps_s) < 2:
        return None
    flight = replace(flight, imu=imu)
    known = np.isfinite(velocity.v_m_s).all(axis=1)
    inputs = filter_input(replace(flight, velocity=None, gps=None), trust)
    read_s = velocity.stamps_s[known]
    if len(read_s) == 0:
        return None
    begin_s, end_s = max(inputs.start_s, read_s[0]), min(inputs.end_s, read_s[-1])
    pieces = _without_gaps([imu.stamps_s, read_s], begin_s, end_s) if begin_s < end_s else []
    at_s, ends = np.concatenate([[], *pieces]), np.cumsum([len(piece) for piece in pieces])[:-1]
    if len(at_s) < 2 * _WINDOW_S / _STEP_S:
        return None
    states = filter_motion(inputs, at_s).smoothed
    assert states is not None
    yaw_rad = roll_pitch_yaw_of(states.w_T_b[:, :3, :3])[:, 2]
    level = np.column_stack([np.interp(at_s, read_s, v) for v in velocity.v_m_s[known].T])
    turn = np.exp(1j * yaw_rad)
    made = _without_mean(states.w_v_m_s[:, :2], ends)
    noise_m_s = _noise_m_s(imu.stamps_s, imu.accel_m_s2)
    moved = float(np.sqrt((made**2).sum(axis=1).mean())) / noise_m_s
    if moved < _ABOVE_NOISE:
        return None
    if (np.ptp(velocity.v_m_s[known], axis=0) == 0).all():
        return _doubted("velocity0 does not change while imu0 shows that the vehicle accelerates (stuck?)")
    count = _independent(len(at_s))
    chance = SURE_SIGMAS / np.sqrt(count)
    read = {name: _changes(level @ axes, turn, ends) for name, axes in _AXES.items()}
    if witness != "imu0":
        return _other_axes(read, made, chance, witness)
    return (
        _other_axes(read, made, chance)
        or _compared(read[""], made, chance, moved)
        or _in_a_part(read, made, at_s, noise_m_s)
        or _other_zero(read[""], made, turn, ends, count, trust.velocity_error_m_s)
    )


def _imu_by_lean(attitude: AttitudeSeries | None) -> Imu | None:
    """Return the readings of an IMU on a vehicle that is only carried by a thrust along its z, and turns as
    the attitude says; None without a complete attitude."""
    if attitude is None:
        return None
    known = np.isfinite(attitude.roll_pitch_yaw_rad).all(axis=1)
    stamps_s, angles = attitude.stamps_s[known], attitude.roll_pitch_yaw_rad[known]
    if len(stamps_s) < 2 or not (np.diff(stamps_s) > 0).all():
        return None
    w_R_b = Rotation.from_matrix(rotation_of(angles))
    turn_rad = (w_R_b[:-1].inv() * w_R_b[1:]).as_rotvec()
    rate = np.gradient(np.concatenate([np.zeros((1, 3)), np.cumsum(turn_rad, axis=0)]), stamps_s, axis=0)
    # At a constant height the thrust carries the weight.
    up = np.maximum(np.abs(np.cos(angles[:, :2]).prod(axis=1)), _LEAST_COSINE)
    return Imu(stamps_s, rate, np.column_stack([0 * up, 0 * up, GRAVITY_M_S2 / up]))


def _doubted(finding: str, check: str = _CHECK) -> Message:
    return warning(f"{finding}: {_DOUBT}", check)


def _without_gaps(streams: list[Array], begin_s: float, end_s: float) -> list[Array]:
    """Return the times at which velocities are compared, in pieces (k,) between the gaps of all streams.

    Over a gap of a window the change of one velocity has nothing to do with that of the other. ``streams``
    are the stamps of each, in order; ``begin_s`` and ``end_s`` bound the times.
    """
    begins_s, ends_s = [], []
    for stamps_s in streams:
        lost = np.flatnonzero(gaps(stamps_s, _WINDOW_S / 2))
        begins_s.append(stamps_s[lost])
        ends_s.append(stamps_s[lost + 1])
    gap_begins_s, gap_ends_s = np.concatenate(begins_s), np.concatenate(ends_s)
    edges_s = np.unique(np.clip([begin_s, end_s, *gap_begins_s, *gap_ends_s], begin_s, end_s))
    pieces = []
    for first_s, last_s in pairwise(edges_s.tolist()):
        middle_s = (first_s + last_s) / 2
        in_gap = bool(((gap_begins_s < middle_s) & (middle_s <= gap_ends_s)).any())
        if not in_gap and last_s - first_s > _WINDOW_S:
            pieces.append(np.arange(first_s, last_s, _STEP_S))
    return pieces


def _independent(rows: int) -> float:
    """Return the number of independent changes of velocity: two axes, twice in a window."""
    return 2 * max(rows * _STEP_S / (0.5 * _WINDOW_S), 1.0)


def _in_a_part(read: Mapping[str, Array], made: Array, at_s: Array, noise_m_s: float) -> Message | None:
    """Compare changes of velocity (n, 2) in parts of the flight: axes may change in mid-flight."""
    for parts in _PARTS:
        for rows in np.array_split(np.arange(len(at_s)), parts):
            if float(np.sqrt((made[rows] ** 2).sum(axis=1).mean())) < _ABOVE_NOISE * noise_m_s:
                continue
            chance = _SURE_IN_PARTS / np.sqrt(_independent(len(rows)))
            of_part = {name: changes[rows] for name, changes in read.items()}
            if line := _other_axes(of_part, made[rows], chance):
                return line.prefixed(f"from {at_s[rows[0]]:.1f} to {at_s[rows[-1]]:.1f} s")
    return None


def _other_zero(
    read: Array,
    made: Array,
    turn: NDArray[np.complex128],
    ends: NDArray[np.int64],
    independent: float,
    usual_m_s: float,
) -> Message | None:
    """Describe a constant error of the velocity, which turns with the vehicle, beyond the ``usual_m_s``.

    Changes of velocity (n, 2) by the IMU are fitted by those that are read, with a gain, and by those of a
    constant velocity forward and left. At one heading the latter are none, and nothing is known.
    ``independent``: the number of changes that do not depend on each other.
    """
    constants = [_changes(np.tile(axis, (len(turn), 1)), turn, ends) for axis in np.eye(2)]
    columns = np.column_stack([c.ravel() for c in (read, *constants)])
    inverse = np.linalg.pinv(columns.T @ columns)
    fitted = inverse @ columns.T @ made.ravel()
    rest = made.ravel() - columns @ fitted
    std = np.sqrt(np.diag(inverse) * float(rest @ rest) / independent)
    gain, error = fitted[0], -fitted[1:]
    if gain < _SURE_OF_ZERO * std[0] or (np.abs(error) - _SURE_OF_ZERO * std[1:]).max() < usual_m_s:
        return None
    forward, left = error / gain
    return warning(
        f"velocity0 has a constant error of about {forward:.2g} m/s forward and {left:.2g} m/s left, as the "
        "turns show beside imu0: the track over ground is not to be trusted",
        "check the zero of velocity0 with the vehicle at rest",
    )


def _changes(level: Array, turn: NDArray[np.complex128], ends: NDArray[np.int64]) -> Array:
    """Return changes of velocity (n, 2) in axes that do not turn, from those forward and left (n, 2)."""
    along = (level[:, 0] + 1j * level[:, 1]) * turn
    return _without_mean(np.column_stack([along.real, along.imag]), ends)


def _correlation(read: Array, made: Array) -> float:
    return float((read * made).sum()) / float(np.sqrt((read**2).sum() * (made**2).sum()))


def _other_axes(
    read: Mapping[str, Array], made: Array, chance: float, witness: str = "imu0"
) -> Message | None:
    """Compare changes of velocity (n, 2) by the IMU with those that are read, by names of other axes.

    Other axes must correlate beyond chance, and by as much better than those that are told.
    """
    alike = {name: _correlation(changes, made) for name, changes in read.items()}
    best = max(alike, key=lambda name: alike[name])
    if alike[best] < chance or alike[best] - alike[""] < chance:
        return None
    return _doubted(
        f"velocity0 changes as {witness} shows with {best} (correlation {alike[best]:.2f}, as it is "
        f"{alike['']:.2f}; axes or signs?)",
        _CHECK if witness == "imu0" else f"{_CHECK}, and axes and signs of attitude0",
    )


def _compared(read: Array, made: Array, chance: float, moved: float) -> Message | None:
    """Compare changes of velocity (n, 2); ``moved``: those by the IMU over their noise. ``chance`` is the
    correlation of changes that have nothing in common, with its largest error."""
    of_read, of_made = float((read**2).sum()), float((made**2).sum())
    alike = _correlation(read, made)
    larger = float((read * made).sum()) / of_made
    if alike < -chance:
        return _doubted(f"velocity0 changes against what imu0 shows (correlation {alike:.2f}; signs?)")
    if alike < chance and moved > _FAR_ABOVE_NOISE:
        return _doubted(f"velocity0 does not change as imu0 shows (correlation {alike:.2f}; stuck, or axes?)")
    if (
        alike > chance
        and not 1 / LARGEST_GAIN < np.sqrt(of_read / of_made) < LARGEST_GAIN
        and not 1 / LARGEST_GAIN < larger < LARGEST_GAIN
    ):
        return _doubted(f"velocity0 changes by {larger:.2g} times what imu0 shows (unit?)")
    return None


def _without_mean(values: Array, ends: NDArray[np.int64]) -> Array:
    """Return values (n, c) without their mean over a window, in each piece between the rows ``ends``."""
    size = int(_WINDOW_S / _STEP_S) + 1
    pieces = np.split(values, ends)
    return np.concatenate([piece - uniform_filter1d(piece, size, axis=0, mode="nearest") for piece in pieces])


def _noise_m_s(stamps_s: Array, accel_m_s2: Array) -> float:
    """Return the standard deviation of a velocity from the accelerometer about its mean over a window.

    White noise integrates to a random walk, whose variance in the middle of a window about the mean of the
    window is a twelfth of that at its end.
    """
    # Two level axes; which of the body's axes they are depends on the mount. No sensor is exact.
    return max(white_density(stamps_s, accel_m_s2) * float(np.sqrt(2 * _WINDOW_S / 12)), 1e-6)
