"""Checks of units that a header cannot show: gyro in degrees, accelerometer in g, stamps in microseconds.

Each check compares the data with a limit that only a wrong unit exceeds. The error names the likely cause.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slam.core.messages import Message, warning
from slam.core.streams import AttitudeSeries, Imu
from slam.io.csv_table import CsvTable
from slam.io.files import refusal
from slam.io.sensor_yaml import YamlFile

MIN_INTERVAL_NS = 20_000
"""Smallest interval of stamps. No sensor of a flight folder is faster than 50 kHz."""
GYRO_LIMIT_RAD_S = 70.0
"""Largest plausible rate: 4000 deg/s, the widest range of any MEMS gyro."""
_TIME_UNITS = {1e3: "microseconds", 1e6: "milliseconds", 1e9: "seconds"}


def check_stamp_unit(table: CsvTable, sensor: YamlFile, notes: list[Message]) -> None:
    """Refuse stamps in another unit than nanoseconds. Note a rate far from ``rate_hz``.

    Raises ``InputError``.
    """
    steps = np.diff(np.sort(table.stamps_ns))
    steps = steps[steps > 0]
    nominal_hz = sensor.number("rate_hz", 0.0)
    if len(steps) < 3:
        return
    rate_hz = 1e9 / float(np.median(steps))
    for factor, unit in _TIME_UNITS.items():
        if nominal_hz > 0 and 1 / 1.5 < rate_hz / nominal_hz / factor < 1.5:
            what = f"stamps step by {np.median(steps):g}, which at rate_hz {nominal_hz:g} are {unit}"
            raise refusal(
                table.path, what, "convert them to nanoseconds", int(table.lines[0]), table.row_word
            )
    if 1e9 / rate_hz < MIN_INTERVAL_NS:
        unit = "microseconds" if rate_hz < 1e9 / 500 else "milliseconds or seconds"
        what = f"stamps step by {np.median(steps):g} ns, faster than any sensor"
        raise refusal(
            table.path, what, f"convert them to nanoseconds ({unit}?)", int(table.lines[0]), table.row_word
        )
    mean_hz = len(steps) * 1e9 / float(steps.sum())
    if nominal_hz > 0 and (
        min(rate_hz, mean_hz) > 1.5 * nominal_hz or max(rate_hz, mean_hz) < nominal_hz / 1.5
    ):
        notes.append(
            warning(
                f"its rate is {rate_hz:.3g} Hz but sensor.yaml gives {nominal_hz:g} Hz",
                "check for lost rows, or correct rate_hz",
            )
        )


def check_stamps_agree(tables: dict[str, CsvTable]) -> None:
    """Refuse a stream whose stamps are in another unit than those of the others. Raises ``InputError``."""
    first = {name: float(t.stamps_ns[0]) for name, t in tables.items() if len(t.stamps_ns)}
    if not first:
        return
    latest = max(first, key=lambda n: first[n])
    if first[latest] < 1e17:
        return  # clocks that start near zero cannot be distinguished this way
    for name, stamp in first.items():
        for factor, unit in _TIME_UNITS.items():
            if stamp > 0 and abs(stamp * factor / first[latest] - 1) < 1e-3:
                table = tables[name]
                what = f"stamps are those of {latest} in {unit}"
                raise refusal(
                    table.path, what, "convert them to nanoseconds", int(table.lines[0]), table.row_word
                )


def check_imu_units(imu: Imu, attitude: AttitudeSeries | None, path: Path) -> None:
    """Refuse a gyro in degrees and an accelerometer in g. Raises ``InputError``."""
    accel = float(np.median(np.linalg.norm(imu.accel_m_s2, axis=1)))
    if 0.7 < accel < 1.4:
        what = f"the accelerometer's median is {accel:.3g} m/s^2"
        raise refusal(path, what, "convert it to m/s^2 (in g? multiply by 9.80665)")
    if 600 < accel < 1400 or 6000 < accel < 14000:
        unit = "cm/s^2 or thousandths of g" if accel < 1400 else "mm/s^2"
        what = f"the accelerometer's median is {accel:.3g} m/s^2"
        raise refusal(path, what, f"convert it to m/s^2 (in {unit}?)")
    rate = np.linalg.norm(imu.gyro_rad_s, axis=1)
    if np.mean(rate > GYRO_LIMIT_RAD_S) > 0.01:
        what = f"the gyro reads up to {rate.max():.3g} rad/s"
        raise refusal(path, what, "convert it to rad/s (in deg/s? multiply by pi/180)")
    ratio = _gyro_to_attitude_ratio(imu, attitude) if attitude is not None else math.nan
    if 30 < ratio < 110:
        what = f"the gyro reads {ratio:.0f} times the rate at which the attitude turns"
        raise refusal(path, what, "convert it to rad/s (in deg/s? multiply by pi/180)")
    if 1 / 110 < ratio < 1 / 30:
        what = f"the attitude turns {1 / ratio:.0f} times faster than the gyro measures"
        raise refusal(
            path.parent.parent / "attitude0" / "data.csv", what, "convert it to radians (in degrees?)"
        )


def _gyro_to_attitude_ratio(imu: Imu, attitude: AttitudeSeries) -> float:
    """Return the ratio of the gyro's rate to the attitude's, from their increments; NaN if they are
    uncorrelated.
    """
    start = max(imu.stamps_s[0], attitude.stamps_s[0])
    end = min(imu.stamps_s[-1], attitude.stamps_s[-1])
    if end - start < 2 or len(imu.stamps_s) < 20 or len(attitude.stamps_s) < 20:
        return math.nan
    times = np.arange(start, end, 0.25)
    steps = np.diff(imu.stamps_s, prepend=imu.stamps_s[0])
    gyro_increments, attitude_increments = [], []
    for axis in range(3):
        angle = attitude.roll_pitch_yaw_rad[:, axis]
        known = np.isfinite(angle)
        if known.sum() < 20:
            continue
        gyro_increments.append(_increments(times, imu.stamps_s, np.cumsum(imu.gyro_rad_s[:, axis] * steps)))
        attitude_increments.append(_increments(times, attitude.stamps_s[known], angle[known]))
    if not gyro_increments:
        return math.nan
    x, y = np.concatenate(attitude_increments), np.concatenate(gyro_increments)
    calm = np.abs(x) < np.percentile(np.abs(x), 95) * 3 + 1e-12  # a wrap of yaw is not a motion
    x, y = x[calm], y[calm]
    if x.std() < 1e-4 or y.std() < 1e-4 or abs(np.corrcoef(x, y)[0, 1]) < 0.5:
        return math.nan
    return float(y.std() / x.std())


def _increments(
    times: NDArray[np.float64], stamps: NDArray[np.float64], value: NDArray[np.float64]
) -> NDArray[np.float64]:
    increments = np.diff(np.interp(times, stamps, value))
    return np.asarray(increments - np.median(increments))
