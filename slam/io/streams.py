"""Columns of the streams of a flight folder, and construction of a series from a table and its
``sensor.yaml``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from slam.core.geodesy import MAX_ALTITUDE_M
from slam.core.instrument import Instrument
from slam.core.messages import warning
from slam.core.streams import AttitudeSeries, Command, Gps, Imu, Motor, Scalar, Sonar, Truth, Velocity
from slam.io.assumed import assumed_keys
from slam.io.csv_header import CsvColumn
from slam.io.gps_accuracy import accuracy_in_metres, median_and_each, stated_stds, typical_accuracy
from slam.io.gps_heights import stated_height_system
from slam.io.plausibility import GYRO_LIMIT_RAD_S
from slam.io.sensor_yaml import MAX_LEVER_M
from slam.io.series_source import Source

Array = NDArray[np.float64]
Series = Imu | Sonar | AttitudeSeries | Velocity | Command | Scalar | Motor | Gps | Truth

MAX_SHARE_STD = 1.0
"""Largest standard deviation of a scale or of another share of a value: the whole value."""
ACCEL_LIMIT_M_S2 = 4000.0
"""Largest plausible specific force: 400 g, the widest range of any MEMS accelerometer."""
SATURATION_RATIO = 0.999
"""Share of max_range above which a range is treated as the sonar's value for no echo."""
_USUAL_MAX_RANGE_M = 6.0
"""Reach of a small drone's sonar (AR.Drone)."""
_UNITS_RATIO = 5.0
"""Ratio of a median range to the limit above which the unit is doubted; other units differ by 100."""


def _axes(name: str, axes: str, unit: str, limit: float, optional: bool = False) -> tuple[CsvColumn, ...]:
    return tuple(CsvColumn(f"{name}_{axis}", unit, limit, optional) for axis in axes)


COLUMNS: dict[str, tuple[CsvColumn, ...]] = {
    "imu0": _axes("w_RS_S", "xyz", "rad s^-1", 1e4) + _axes("a_RS_S", "xyz", "m s^-2", 1e5),
    "sonar0": (CsvColumn("range", "m", 1e6),),
    "attitude0": tuple(CsvColumn(name, "rad", 1e5) for name in ("roll", "pitch", "yaw")),
    "velocity0": _axes("v", "xy", "m s^-1", 300.0),
    "command0": tuple(CsvColumn(name, "1", 1e6) for name in ("forward", "left", "up", "yaw")),
    "battery0": (CsvColumn("voltage", "V", 1e3),),
    "gps0": (
        CsvColumn("latitude", "deg", 1e10),
        CsvColumn("longitude", "deg", 1e10),
        CsvColumn("altitude", "m", MAX_ALTITUDE_M),
        *(CsvColumn(f"std_{axis}", "m", MAX_ALTITUDE_M, optional=True) for axis in ("east", "north", "up")),
    ),
    "barometer0": (CsvColumn("altitude", "m", MAX_ALTITUDE_M),),
    "motor0": tuple(CsvColumn(f"m{k}", "1", 1e6) for k in range(1, 5)),
    "state_groundtruth_estimate0": (
        *_axes("p_RS_R", "xyz", "m", 1e8),
        *_axes("q_RS", "wxyz", "", 1e3),
        *_axes("v_RS_R", "xyz", "m s^-1", 1e3, optional=True),
        *_axes("b_w_RS_S", "xyz", "rad s^-1", 1e3, optional=True),
        *_axes("b_a_RS_S", "xyz", "m s^-2", 1e4, optional=True),
    ),
}
"""Map of a folder to its columns after the stamp, in the order of the format."""

IMU_DENSITIES = {
    "gyroscope_noise_density": "gyro_noise_density",
    "accelerometer_noise_density": "accel_noise_density",
    "gyroscope_random_walk": "gyro_random_walk",
    "accelerometer_random_walk": "accel_random_walk",
}
"""Map of a key of imu0's ``sensor.yaml`` to the field of ``Imu``."""

KNOWN_KEYS = (
    "sensor_type", "comment", "T_BS", "rate_hz", "noise_std", "min_range", "max_range", "beam_width",
    "max_tilt", "resolution", "camera_model", "intrinsics", "distortion_model", "distortion_coefficients",
    "focal_std_ratio", "aspect_std_ratio", "center_std", "radial_std", "tangential_std", "mount_std",
    "readout", "scale_std", "datum_std", "antenna_std", "height_system", "assumed", *IMU_DENSITIES,
)  # fmt: skip


def _limits(folder: str) -> tuple[float, ...]:
    return tuple(column.limit for column in COLUMNS[folder])


def build_series(folder: str, source: Source) -> Series | None:
    """Return the series of one stream, or None if no row is left. Raises ``InputError``."""
    if len(source.table.stamps_ns) == 0:
        return None
    series = _BUILDERS[folder](source)
    if isinstance(series, Instrument):
        in_rows = folder == "gps0" and typical_accuracy(stated_stds(source.table.values)) is not None
        series = replace(series, assumed=assumed_keys(folder, source.sensor, in_rows))
    return series if len(series.stamps_s) else None


def _imu(source: Source) -> Imu:
    source = source.keep_rows(np.isfinite(source.table.values).all(axis=1), "a value is missing")
    values = source.table.values
    return Imu(
        stamps_s=source.stamps_s,
        gyro_rad_s=values[:, :3],
        accel_m_s2=values[:, 3:],
        **_imu_densities(source),
        b_T_s=source.sensor.transform(),
    )


def _imu_densities(source: Source) -> dict[str, Any]:
    """Return the noise densities of an IMU. Raises ``InputError`` where the noise would exceed its range.

    White noise of density n has the standard deviation n sqrt(rate) in each reading. A random walk of density
    n has n sqrt(duration) at the end.
    """
    stamps_s = source.stamps_s
    duration_s = float(stamps_s[-1] - stamps_s[0]) if len(stamps_s) > 1 else 1.0
    rate_hz = 1 / float(np.median(np.diff(stamps_s))) if len(stamps_s) > 1 else 1.0
    densities = {}
    for key, name in IMU_DENSITIES.items():
        largest = GYRO_LIMIT_RAD_S if key.startswith("gyro") else ACCEL_LIMIT_M_S2
        largest /= math.sqrt(rate_hz if key.endswith("density") else duration_s)
        densities[name] = source.sensor.number(key, getattr(Imu, name), positive=key.endswith("density"))
        source.sensor.check_std(key, densities[name], largest)
    return densities


def _sonar(source: Source) -> Sonar:
    sensor, values = source.sensor, source.table.values
    low = sensor.number("min_range", Sonar.min_range_m)
    high = sensor.number("max_range", Sonar.max_range_m, positive=True)
    if low >= high:
        raise sensor.refuse(
            "max_range", f"is {high:g} where min_range is {low:g}", "write min_range < max_range"
        )
    (largest,) = _limits("sonar0")
    if largest < high < math.inf:
        # Else the noise, which the range bounds, would be blamed.
        raise sensor.refuse("max_range", f"is {high:g}", f"write the sensor's own, at most {largest:g} m")
    scale_std = sensor.std("scale_std", Sonar.scale_std, MAX_SHARE_STD)
    reach = high if high < math.inf else float(np.nanmax(values, initial=_USUAL_MAX_RANGE_M))
    datum_std_m = sensor.std("datum_std", Sonar.datum_std_m, reach)
    beam_rad = sensor.number("beam_width", Sonar.beam_width_rad)
    if beam_rad >= math.pi:
        raise sensor.refuse("beam_width", f"is {beam_rad:g}", "write radians below pi (degrees?)")
    median = float(np.nanmedian(values)) if np.isfinite(values).any() else 0.0
    if high == math.inf and median > _UNITS_RATIO * _USUAL_MAX_RANGE_M:
        source.notes.append(
            warning(
                f"has a median range of {median:g} m, and no max_range is stated",
                "write max_range into sensor.yaml, or convert the ranges to metres if they are centimetres",
            )
        )
    if median > _UNITS_RATIO * high:
        unit = "centimetres" if median * 0.01 <= high else "millimetres"
        raise source.row_error(0, f"has a median range of {median:g} m", f"convert it to metres ({unit}?)")
    source.set_missing(values[:, 0] <= 0, 0, "a range of zero or less")
    source.set_missing(values[:, 0] >= SATURATION_RATIO * high, 0, f"at or beyond max_range {high:g} m")
    return Sonar(
        stamps_s=source.stamps_s,
        range_m=values[:, 0],
        noise_std_m=source.noise((Sonar.noise_std_m,), (reach,))[0],
        min_range_m=low,
        max_range_m=high,
        beam_width_rad=beam_rad,
        scale_std=scale_std,
        datum_std_m=datum_std_m,
        b_T_s=sensor.transform(),
    )


def _attitude(source: Source) -> AttitudeSeries:
    source.check_identity_mount()
    tilt = source.table.values[:, :2]
    too_large = np.abs(tilt) > math.pi + 1e-6
    if too_large.sum() > max(1, 0.02 * np.isfinite(tilt).sum()):
        row = int(np.argmax(too_large.any(axis=1)))
        raise source.row_error(row, "has roll or pitch beyond pi", "convert to radians (degrees?)")
    for column, name in enumerate(("roll", "pitch")):
        source.set_missing(too_large[:, column], column, f"{name} beyond pi")
    noise = source.noise(AttitudeSeries.noise_std_rad, (math.pi,) * 3)
    return AttitudeSeries(source.stamps_s, source.table.values, (noise[0], noise[1], noise[2]))


def _velocity(source: Source) -> Velocity:
    source.check_identity_mount()
    noise = source.noise(Velocity.noise_std_m_s, _limits("velocity0"))
    scale_std = source.sensor.std("scale_std", Velocity.scale_std, MAX_SHARE_STD)
    return Velocity(source.stamps_s, source.table.values, (noise[0], noise[1]), scale_std)


def _command(source: Source) -> Command:
    source.noise((0.0,) * 4, _limits("command0"))
    too_large = (np.abs(source.table.values) > 1 + 1e-9).any(axis=1)
    if too_large.any():
        row = int(np.argmax(too_large))
        value = source.table.values[row][np.nanargmax(np.abs(source.table.values[row]))]
        guess = " (percent?)" if np.nanmax(np.abs(source.table.values)) > 20 else ""
        raise source.row_error(row, f"has the command {value:g}", f"scale the stick to -1..1{guess}")
    max_tilt_rad = source.sensor.number("max_tilt", Command.max_tilt_rad, positive=True)
    if max_tilt_rad >= math.pi / 2:
        raise source.sensor.refuse("max_tilt", f"is {max_tilt_rad:g}", "write radians below pi/2 (degrees?)")
    return Command(source.stamps_s, source.table.values, max_tilt_rad)


def _barometer(source: Source) -> Scalar:
    return _scalar(source, _limits("barometer0"))


def _battery(source: Source) -> Scalar:
    return _scalar(source, _limits("battery0"))


def _scalar(source: Source, largest: Sequence[float]) -> Scalar:
    source.check_identity_mount()
    return Scalar(source.stamps_s, source.table.values[:, 0], source.noise((Scalar.noise_std,), largest)[0])


def _motor(source: Source) -> Motor:
    source.noise((0.0,) * 4, _limits("motor0"))
    return Motor(source.stamps_s, source.table.values)


def _gps(source: Source) -> Gps:
    b_T_s, antenna_std_m = source.sensor.transform(), source.sensor.std("antenna_std", 0.0, MAX_LEVER_M)
    system = stated_height_system(source.sensor)
    for column, name, limit in ((0, "latitude", 90), (1, "longitude", 180)):
        too_large = np.abs(source.table.values[:, column]) > limit
        if too_large.any():
            row = int(np.argmax(too_large))
            value = source.table.values[row, column]
            guess = " (1e7 times?)" if abs(value) > 1e6 else ""
            raise source.row_error(row, f"has {name} {value:g} deg", f"write -{limit}..{limit}{guess}")
    latitude, longitude = source.table.values[:, 0], source.table.values[:, 1]
    source = source.keep_rows(np.isfinite(latitude) & np.isfinite(longitude), "no position")
    fixed = (source.table.values[:, 0] != 0) | (source.table.values[:, 1] != 0)
    source = source.keep_rows(fixed, "latitude and longitude are both 0 (no fix yet)")
    latitude, longitude, altitude = source.table.values.T[:3]
    stated_m = stated_stds(source.table.values)
    if not len(latitude):
        noise = Gps.noise_std_m
    elif source.sensor.has("noise_std"):  # in the units of the columns: deg, deg, m
        noise_std = source.noise(Gps.noise_std_m, (MAX_ALTITUDE_M,) * 3)
        noise = accuracy_in_metres(noise_std, float(latitude[0]), source.notes)
    else:
        noise = typical_accuracy(stated_m) or Gps.noise_std_m
    noise, stds_m = median_and_each(stated_m, noise)
    return Gps(source.stamps_s, latitude, longitude, altitude, noise, b_T_s, antenna_std_m, stds_m, system)


def _truth(source: Source) -> Truth:
    source.check_identity_mount()
    source = source.keep_rows(np.isfinite(source.table.values[:, :7]).all(axis=1), "part of the pose missing")
    norm = np.linalg.norm(source.table.values[:, 3:7], axis=1)
    unit = np.abs(norm - 1) < 1e-2
    if (~unit).sum() > 0.5 * len(norm):
        row = int(np.argmin(unit))
        raise source.row_error(
            row, f"has a quaternion of length {norm[row]:g}", "write unit quaternions, w x y z"
        )
    source = source.keep_rows(unit, "the quaternion's length is not 1")
    values = source.table.values
    w_T_b = np.tile(np.eye(4), (len(values), 1, 1))
    w_T_b[:, :3, 3] = values[:, :3]
    if len(values):
        w_T_b[:, :3, :3] = Rotation.from_quat(values[:, 3:7], scalar_first=True).as_matrix()
    velocity = values[:, 7:10].copy()  # the slice alone would keep all columns in memory
    return Truth(source.stamps_s, w_T_b, velocity if np.isfinite(velocity).any() else None)


_BUILDERS: dict[str, Callable[[Source], Series]] = {
    "imu0": _imu,
    "sonar0": _sonar,
    "attitude0": _attitude,
    "velocity0": _velocity,
    "command0": _command,
    "battery0": _battery,
    "gps0": _gps,
    "barometer0": _barometer,
    "motor0": _motor,
    "state_groundtruth_estimate0": _truth,
}
