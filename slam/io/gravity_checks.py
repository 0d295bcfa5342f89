"""Checks of signs, units and orders that gravity shows: of the gyro, and of the truth's quaternions.

The specific force is gravity but for the vehicle's acceleration, whose mean over some seconds is small. In
axes that do not turn it is therefore nearly constant. A gyro in another unit or with another sign turns it
away.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from backend.measurements import GRAVITY_M_S2
from backend.quaternions import composed
from slam.core.streams import Imu, Truth
from slam.io.files import refusal

Array = NDArray[np.float64]

_WINDOW_S, _SHORTEST_S = 5.0, 2.0
_MOST_SINKING_M_S = 5.0
"""Largest downward change of speed over a recording. A level one adds to gravity at right angles, and can
only enlarge the sum."""
_SHORT_SHARE = 0.05
"""Share by which a poorly calibrated accelerometer reads short of gravity."""
_STEP_S = 0.25
"""Turns over so long exceed the noise of gyro and truth."""
_MOST_TILT_RAD = np.radians(45.0)
"""A vehicle that is on its side for half of its flight has wrong quaternions."""
_WRONG_GYROS = (
    (np.radians(1.0), "convert it to rad/s (in deg/s? multiply by pi/180)"),
    (-1.0, "turn its signs: it must follow the right-hand rule, as the accelerometer does"),
)
"""Factors that would make a gyro right, and what to do."""


def check_gyro_by_gravity(imu: Imu, path: Path) -> None:
    """Refuse a gyro that turns gravity away, where another unit or sign would not. Raises ``InputError``."""
    as_read, lasts_s = _remaining_gravity(imu, 1.0)
    corrected = [_remaining_gravity(imu, factor)[0] for factor, _ in _WRONG_GYROS]
    best = int(np.argmax(corrected))
    # A banked turn presses with more than gravity: such a reading does not speak against the gyro.
    expected = min(corrected[best], GRAVITY_M_S2)
    if lasts_s > 0 and as_read < (1 - _SHORT_SHARE) * expected - _MOST_SINKING_M_S / lasts_s:
        what = f"turned by the gyro, the accelerometer's mean over {_WINDOW_S:g} s is {as_read:.1f} m/s^2"
        raise refusal(path, f"{what}, but gravity is {GRAVITY_M_S2:.1f}", _WRONG_GYROS[best][1])


def check_quaternion_order(truth: Truth, imu: Imu, path: Path) -> None:
    """Refuse quaternions x y z w under the header w x y z: gravity shows which way is up, and the gyro how
    the vehicle turns.

    Raises ``InputError``.
    """
    stamps_s, b_gyro, b_force = _in_body(imu)
    inside = (truth.stamps_s >= stamps_s.min(initial=np.inf)) & (
        truth.stamps_s <= stamps_s.max(initial=-np.inf)
    )
    if inside.sum() < 2:
        return
    every = max(1, int(_STEP_S * inside.sum() / max(float(np.ptp(truth.stamps_s[inside])), _STEP_S)))
    inside = np.flatnonzero(inside)[::every]
    at_s = truth.stamps_s[inside]
    force = _at(at_s, stamps_s, b_force)
    steps = np.diff(stamps_s, prepend=stamps_s[0])[:, None]
    by_gyro = np.diff(_at(at_s, stamps_s, np.cumsum(b_gyro * steps, axis=0)), axis=0)
    as_read = Rotation.from_matrix(truth.w_T_b[inside, :3, :3])
    turned = Rotation.from_quat(as_read.as_quat(scalar_first=True), scalar_first=False)
    leans_rad = _tilt_rad(as_read, force)
    misfit, turned_misfit = (_unexplained(w_R_b, by_gyro) for w_R_b in (as_read, turned))
    # Where the quaternions as read explain the gyro, it is the accelerometer that is turned. In the other
    # order the turns about one axis remain what they are.
    explained = misfit < min(1.0, turned_misfit / 2)
    what = ""
    if leans_rad > _MOST_TILT_RAD > _tilt_rad(turned, force) and not explained:
        what = f"by its quaternions the vehicle leans by {np.degrees(leans_rad):.0f} deg (median)"
    elif misfit > 1 > 2 * turned_misfit:
        what = "by its quaternions the vehicle turns otherwise than by imu0"
    if what:
        raise refusal(path, what, "write quaternions as w x y z (are they x y z w?)")


def _unexplained(w_R_b: Rotation, by_gyro: Array) -> float:
    """Return the share of turns (n, 3) by the gyro that attitudes (n + 1,) do not explain; 0 explains all."""
    made = (w_R_b[:-1].inv() * w_R_b[1:]).as_rotvec()
    return float(((made - by_gyro) ** 2).sum() / max(float((by_gyro**2).sum()), 1e-300))


def _in_body(imu: Imu) -> tuple[Array, Array, Array]:
    """Return stamps (k,), rates and specific forces (k, 3) in body axes, of complete readings."""
    known = np.isfinite(imu.gyro_rad_s).all(axis=1) & np.isfinite(imu.accel_m_s2).all(axis=1)
    turn = imu.b_T_s[:3, :3].T
    return imu.stamps_s[known], imu.gyro_rad_s[known] @ turn, imu.accel_m_s2[known] @ turn


def _at(at_s: Array, stamps_s: Array, values: Array) -> Array:
    return np.column_stack([np.interp(at_s, stamps_s, axis) for axis in values.T])


def _tilt_rad(w_R_b: Rotation, b_force: Array) -> float:
    """Return the median angle between the specific force and the world's vertical."""
    w_force = w_R_b.apply(b_force)
    return float(np.median(np.arctan2(np.hypot(w_force[:, 0], w_force[:, 1]), w_force[:, 2])))


def _remaining_gravity(imu: Imu, factor: float) -> tuple[float, float]:
    """Return the mean over windows of the size of the mean specific force, in axes held by the gyro's
    readings times ``factor``, and the seconds that the windows last; zeros for a short recording."""
    stamps_s, gyro, force = _in_body(imu)
    window = np.floor((stamps_s - stamps_s[:1]) / _WINDOW_S).astype(np.int64)
    sizes, lasts_s = [], []
    for rows in np.split(np.arange(len(window)), np.flatnonzero(np.diff(window)) + 1):
        if len(rows) < 2 or stamps_s[rows[-1]] - stamps_s[rows[0]] < _SHORTEST_S:
            continue
        steps = factor * gyro[rows[:-1]] * np.diff(stamps_s[rows])[:, None]
        by_gyro = Rotation.from_quat(composed(Rotation.from_rotvec(steps).as_quat()))
        sizes.append(float(np.linalg.norm(by_gyro.apply(force[rows]).mean(axis=0))))
        lasts_s.append(float(stamps_s[rows[-1]] - stamps_s[rows[0]]))
    return (float(np.average(sizes, weights=lasts_s)), sum(lasts_s)) if sizes else (0.0, 0.0)
