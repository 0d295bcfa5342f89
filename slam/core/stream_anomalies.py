"""Calibrations of cameras, and readings of height sensor and velocity, that no healthy sensor has."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import bdtrc

from backend.measurements import GRAVITY_M_S2
from frontend.camera import Camera
from slam.core.messages import Message, about
from slam.core.streams import Imu, Sonar, Velocity

Array = NDArray[np.float64]

MOST_OFF_CENTRE = 0.1
"""Share of the picture by which a principal point is off its middle; lenses are mounted to a few hundredths.
The nearest usual ratios of resolutions or heights, 4 to 3, move it by an eighth."""
MOST_ASPECT = 1.2
"""Ratio of focal lengths between that of television's pixels (12 to 11) and that of a picture of 4 to 3 that
was stretched to 16 to 9."""
ECHO_RATIO = 1.5
"""A single range that exceeds its neighbours by this factor is a multipath echo or an obstacle's edge."""
STUCK_S, STUCK_COUNT = 5.0, 20
"""A reading that repeats for so long and so often is stuck, or the vehicle is on the ground. In a
shorter recording, so many readings must be all."""
SATURATED_SHARE = ECHO_SHARE = 0.01
_LEAST_JUMP = 0.1
"""A height changes by a smaller share between readings at 10 Hz, unless the vehicle climbs its own height in
a second."""
_MOST_STEPS = 2
"""Quantised readings of one height differ by so many steps at most: one to either side."""
LEAST_GRAVITY_M_S2 = 0.25 * GRAVITY_M_S2
"""In every flight the median of the one-second means of the specific force is larger than this, because a
vehicle carries its weight in the mean."""
_MEAN_S = 1.0
"""Duration of a mean: vibration averages out, and gravity does not."""
_NEAR_END = 0.05
"""Share of a channel's range beside either end. A healthy sensor has more readings there than at the end."""
_LEAST_CLIPPED, _FALSE_CLIPPING = 3, 1e-5
"""Fewest readings at an end of the range, as a logger may write one twice; and the probability that as many
are rounded to one value by chance, if larger readings are no more frequent than smaller ones."""


def camera_anomalies(camera: Camera) -> list[Message]:
    """Return a line for a principal point far from the middle, and for pixels that are not square.

    Both are signs of a calibration for another resolution or crop. Nothing in a flight at a fixed heading
    contradicts the second one.
    """
    size, (fu, fv), (cu, cv) = camera.size_px, camera.focal_px, camera.center_px
    shares = ((cu + 0.5) / size[0], (cv + 0.5) / size[1])
    lines = []
    if max(abs(share - 0.5) for share in shares) > MOST_OFF_CENTRE:
        lines.append(
            f"its principal point lies at {100 * shares[0]:.0f} % of the width and {100 * shares[1]:.0f} % "
            "of the height"
        )
    if max(fu / fv, fv / fu) > MOST_ASPECT:
        lines.append(f"its focal lengths {fu:.4g} and {fv:.4g} px make pixels that are not square")
    question = f"are intrinsics those of another resolution or crop than {size[0]} x {size[1]}?"
    return [about("cam0", f"{line}: {question}") for line in lines]


def mean_specific_force_m_s2(stamps_s: Array, accel_m_s2: Array) -> float:
    """Return the median size of the means over a second of readings (n, 3); NaN where none is finite."""
    known = np.isfinite(accel_m_s2).all(axis=1)
    if not known.any():
        return float("nan")
    _, second = np.unique(np.floor(stamps_s[known] / _MEAN_S), return_inverse=True)
    count = np.bincount(second)[:, None]
    sums = np.column_stack([np.bincount(second, column) for column in accel_m_s2[known].T])
    return float(np.median(np.linalg.norm(sums / count, axis=1)))


def imu_axis_anomalies(imu: Imu) -> list[Message]:
    """Return a line if gravity does not lie along the body's z: the IMU's axes or its mount are wrong."""
    known = imu.accel_m_s2[np.isfinite(imu.accel_m_s2).all(axis=1)]
    # Without gravity, what is left has any direction.
    if len(known) == 0 or mean_specific_force_m_s2(imu.stamps_s, imu.accel_m_s2) < LEAST_GRAVITY_M_S2:
        return []
    b_force = imu.b_T_s[:3, :3] @ np.median(known, axis=0)
    up, size = float(b_force[2]), float(np.linalg.norm(b_force))
    if up < -0.5 * GRAVITY_M_S2:
        return [about("imu0", "the accelerometer measures gravity upside down", "check its signs and T_BS")]
    if up < 0.5 * min(size, GRAVITY_M_S2):
        lean_deg = np.degrees(np.arccos(up / size))
        return [
            about(
                "imu0", f"gravity lies {lean_deg:.0f} deg from the body's z", "check the IMU's axes and T_BS"
            )
        ]
    return []


def at_range_end(values: Array) -> NDArray[np.bool_]:
    """Return which readings (n, c), in the sensor's axes, are at an end of its range.

    The largest or smallest reading is an end if more readings equal it than lie beside it, and more than
    rounding explains. Where none lies beside it, the readings have no noise, and nothing is known.
    """
    found = np.zeros(values.shape, dtype=bool)
    for column, ends in zip(values.T, found.T, strict=True):
        known = column[np.isfinite(column)]
        near = _NEAR_END * float(np.ptp(known)) if len(known) else 0.0
        for end in (known.min(), known.max()) if near > 0 else ():
            around = known[np.abs(known - end) <= near]
            count = int(np.sum(around == end))
            if count < _LEAST_CLIPPED or not count > len(around) - count > 0:
                continue
            steps = 1 + near / float(np.diff(np.unique(known)).min())
            if bdtrc(count - 1, len(around), 1 / steps) < _FALSE_CLIPPING:
                ends |= column == end
    return found


def clipped_share(values: Array) -> float:
    """Return the share of readings (n, c), in the sensor's axes, at an end of its range: the largest of a
    channel."""
    return _largest_share(at_range_end(values), values)


def _largest_share(at_end: NDArray[np.bool_], values: Array) -> float:
    """Return the largest share of a channel of readings (n, c) that are ``at_end`` (n, c)."""
    known = np.maximum(np.isfinite(values).sum(axis=0), 1)
    return float(np.max(at_end.sum(axis=0) / known, initial=0.0))


def clipping_anomalies(imu: Imu) -> list[Message]:
    """Return a line for accelerometer and gyro each, if its readings are at the end of its range."""
    lines = []
    for name, values in (("accelerometer", imu.accel_m_s2), ("gyro", imu.gyro_rad_s)):
        at_end = at_range_end(values)
        share, count = _largest_share(at_end, values), int(at_end.any(axis=1).sum())
        if count == 0:
            continue
        many = f"{100 * share:.0f} %" if share > SATURATED_SHARE else f"{count}"
        lines.append(
            about(
                "imu0",
                f"{many} of the readings of the {name} are at the end of its range",
                "what was beyond is lost: set a wider range",
            )
        )
    return lines


def sonar_anomalies(sonar: Sonar) -> list[Message]:
    """Return a line for each kind of range that no healthy sensor gives."""
    known = np.isfinite(sonar.range_m)
    if not known.any():
        return [
            about(
                "sonar0",
                "gives no range at all, so that it measures no lengths",
                "check its limits (max_range), its wiring and its unit",
            )
        ]
    ranges = sonar.range_m[known]
    lines = []
    if negative := int((ranges <= 0).sum()):
        lines.append(
            about(
                "sonar0",
                f"{negative} ranges are zero or negative, which no distance is",
                "leave readings without an echo empty in data.csv",
            )
        )
    limit_m = sonar.max_range_m if np.isfinite(sonar.max_range_m) else _value_without_echo(ranges)
    if (share := float(np.mean(ranges >= 0.999 * limit_m))) > SATURATED_SHARE:
        lines.append(
            about(
                "sonar0",
                f"{100 * share:.0f} % of the ranges are saturated at {limit_m:g} m: they are no heights",
                "fly lower, or correct max_range in sensor.yaml",
            )
        )
    if (share := float(np.mean((ranges > 0) & (ranges < sonar.min_range_m)))) > SATURATED_SHARE:
        lines.append(
            about(
                "sonar0",
                f"{100 * share:.0f} % of the ranges are below its {sonar.min_range_m:g} m: they are no "
                "heights",
                "fly higher, or correct min_range in sensor.yaml",
            )
        )
    around = np.maximum(ranges[:-2], ranges[2:])
    if (share := float(np.mean(ranges[1:-1] > ECHO_RATIO * around)) if len(around) else 0.0) > ECHO_SHARE:
        lines.append(
            about(
                "sonar0",
                f"{100 * share:.0f} % of the ranges jump up for one reading (multipath echoes?): most "
                "are left out of the map",
                "fly lower, or check what reflects the sound",
            )
        )
    if line := stuck_ranges(sonar):
        lines.append(line)
    return lines


def _value_without_echo(ranges: Array) -> float:
    """Return the largest of ranges (n,) if they repeat it and jump to it; infinity otherwise.

    A height that is held, or reached by a climb, has readings just below it, if only by a step of the sensor.
    """
    values, counts = np.unique(ranges, return_counts=True)
    if len(values) < 2 or counts[-1] <= STUCK_COUNT:
        return np.inf
    steps = np.diff(values)
    is_jump = steps[-1] > max(_LEAST_JUMP * values[-1], _MOST_STEPS * steps.min())
    return float(values[-1]) if is_jump else np.inf


def stuck_ranges(sonar: Sonar, least_share: float = 0.0) -> Message | None:
    """Return a line where ranges repeat exactly for long, and are this share of all at least; else None."""
    known = np.isfinite(sonar.range_m)
    if not known.any():
        return None
    stamps_s, range_m = sonar.stamps_s[known], sonar.range_m[known]
    at, lasted_s, share = longest_repeat(stamps_s, range_m[:, None])
    if lasted_s == 0 or share < least_share:
        return None
    return about(
        "sonar0",
        f"reads exactly {range_m[at]:g} m for {lasted_s:.1f} s from {stamps_s[at]:.1f} s (stuck, or "
        "standing on the ground)",
        "if the vehicle flew then, heights and lengths of the map are wrong: repair the sensor, or map "
        "without sonar0",
    )


def longest_repeat(stamps_s: Array, values: Array) -> tuple[int, float, float]:
    """Return where the longest run of equal readings (n, c) begins, its duration in seconds, and its share of
    all readings; the duration is 0 where it has too few readings or is too short."""
    changed = (np.diff(values, axis=0) != 0).any(axis=1)
    edges = np.concatenate([[0], np.flatnonzero(changed) + 1, [len(values)]])
    first, last = edges[:-1], edges[1:] - 1
    lasted_s = np.where(last - first + 1 >= STUCK_COUNT, stamps_s[last] - stamps_s[first], 0.0)
    longest = int(np.argmax(lasted_s))
    stuck = lasted_s[longest] > STUCK_S or len(first) == 1
    share = float(last[longest] - first[longest] + 1) / len(values)
    return int(first[longest]), float(lasted_s[longest]) if stuck else 0.0, share


def velocity_anomalies(velocity: Velocity) -> list[Message]:
    """Return a line for a velocity that is stuck, or one axis of it while the other changes. Both may be zero
    for as long: the vehicle stands then."""
    known = np.isfinite(velocity.v_m_s).all(axis=1) & (velocity.v_m_s != 0).any(axis=1)
    if not known.any():
        return []
    stamps_s, v_m_s = velocity.stamps_s[known], velocity.v_m_s[known]
    do = "if it flew at another speed then, leave velocity0 out"
    at, lasted_s, _ = longest_repeat(stamps_s, v_m_s)
    if lasted_s > 0:
        read = f"{v_m_s[at, 0]:g}, {v_m_s[at, 1]:g}"
        where = f"for {lasted_s:.1f} s from {stamps_s[at]:.1f} s (stuck?)"
        return [about("velocity0", f"reads exactly {read} m/s {where}", do)]
    lines = []
    for k, axis in enumerate(("forward", "left")):
        at, lasted_s, _ = longest_repeat(stamps_s, v_m_s[:, k : k + 1])
        if lasted_s > 0:
            where = f"for {lasted_s:.1f} s from {stamps_s[at]:.1f} s while its other axis changes (stuck?)"
            lines.append(about("velocity0", f"reads exactly {v_m_s[at, k]:g} m/s {axis} {where}", do))
    return lines
