"""Inputs of the filter from a flight: readings in body axes with realistic noise, and an initial state.

The nominal noise of the manufacturers is the lower limit. Where the recording shows more noise, that is used
(`slam.inertial.variogram`, `slam.inertial.noise_identification`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from backend.ekf.inputs import READINGS, FilterModel, InitialState, Readings, Series
from backend.triple import triple
from slam.core.errors import InputError, one_line
from slam.core.rotations import rotation_of
from slam.inertial.instruments import (
    InertialTrust,
    attitude_of,
    barometer_of,
    complete,
    inertial_of,
    positions_of,
    range_of,
    velocity_of,
    zeros_at,
)
from slam.inertial.variogram import CorrelatedProcess
from slam.inertial.zero_velocity import zero_velocity_times

if TYPE_CHECKING:
    from slam.core.flight import Flight

Array = NDArray[np.float64]

_NEAR_S = 0.5
"""Largest distance in time from the start of a reading that determines the initial state."""
_HEIGHT_STD = 0.5
"""Relative standard deviation of the height at the first picture: twice the largest error of its start
(`slam.inertial.start_height`), so that the readings decide."""
START_YAW_STD_RAD = 0.5
"""Standard deviation of a heading at the start that is read once, or found by trying headings 30° apart
(`slam.inertial.start_heading`)."""
_REST_TILT_RAD = 0.01
_REST_STD = 0.01, 0.003
"""Standard deviations of velocity (m/s) and body rate (rad/s) at rest."""


@dataclass(frozen=True)
class PictureStart:
    """First picture of a step, and the height there, where no instrument measures one.

    The filter starts at it: before it, nothing is known of the height, which steps between pictures need.
    """

    stamp_s: float
    height_m: float


@dataclass(frozen=True)
class StartHeading:
    """Heading at the start, east to north, where no yaw was measured but positions tell where north is."""

    yaw_rad: float
    std_rad: float
    is_known: bool = True
    """Whether the motion tells the heading; it may be any otherwise."""


@dataclass(frozen=True)
class Adjustments:
    """Values identified on the readings themselves: noise and delay of each channel, and the start."""

    noise_factor: Mapping[str, float] = field(default_factory=dict)
    """Channel -> factor on the nominal white noise."""
    delay_s: Mapping[str, float] = field(default_factory=dict)
    """Channel -> time by which its stamps are late."""
    start: PictureStart | None = None
    """None where a height is measured, or is not needed."""
    heading: StartHeading | None = None
    """None where a yaw is measured, or the first heading is that of the world."""


@dataclass(frozen=True)
class FilterInput:
    """All inputs of the filter from one flight."""

    readings: Readings
    model: FilterModel
    start: InitialState
    start_s: float
    end_s: float
    """End of the interval in which the motion was recorded; ``start_s`` is its start."""
    range_scale_std: float
    velocity_scale_std: float
    """Standard deviations of the scales, which are fixed at 1 and enter the covariances."""
    adjustments: Adjustments


def filter_input(
    flight: Flight,
    trust: InertialTrust = InertialTrust(),
    adjustments: Adjustments = Adjustments(),
    from_s: float = -np.inf,
) -> FilterInput:
    """Return readings, model and initial state of a flight from ``from_s`` on, without readings before its
    motion was recorded.

    Raises ``InputError`` where the recording is insufficient for the motion.
    """
    start_s, end_s = _span(flight)
    start_s = max(start_s, from_s)
    if adjustments.start is not None:
        start_s = max(start_s, adjustments.start.stamp_s)
    gyro, accel, rate, acceleration = inertial_of(flight)
    rest_s = zero_velocity_times(flight)
    nominal = Readings(
        gyro_rad_s=gyro,
        accel_m_s2=accel,
        roll_pitch_yaw_rad=attitude_of(flight, trust),
        range_m=range_of(flight, trust),
        velocity_m_s=velocity_of(flight, trust),
        w_p_antenna_m=positions_of(flight, trust),
        barometer_m=barometer_of(flight, trust),
        rest_m_s=zeros_at(rest_s, _REST_STD[0]),
        still_rad_s=zeros_at(rest_s, _REST_STD[1]),
    )
    readings = _adjusted(nominal, adjustments).between(start_s, end_s)
    scale = flight.sonar.scale_std if flight.sonar and readings.range_m else 0.0
    velocity_scale = flight.velocity.scale_std if flight.velocity and readings.velocity_m_s else 0.0
    return FilterInput(
        readings=readings,
        model=_model(flight, trust, rate, acceleration),
        start=_start(flight, readings, trust, start_s, adjustments),
        start_s=start_s,
        end_s=end_s,
        range_scale_std=scale,
        velocity_scale_std=velocity_scale,
        adjustments=adjustments,
    )


def _model(
    flight: Flight, trust: InertialTrust, rate: CorrelatedProcess, acceleration: CorrelatedProcess
) -> FilterModel:
    imu, sonar, camera, gps = flight.imu, flight.sonar, flight.camera, flight.gps
    return FilterModel(
        accel_m_s2=acceleration.std,
        accel_time_s=acceleration.time_s,
        rate_rad_s=rate.std,
        rate_time_s=rate.time_s,
        gyro_offset_rad_s=trust.gyro_offset_rad_s,
        gyro_walk_rad_s2=max(imu.gyro_random_walk if imu else 0.0, trust.gyro_walk_rad_s2),
        accel_offset_m_s2=trust.accel_offset_m_s2,
        accel_walk_m_s3=max(imu.accel_random_walk if imu else 0.0, trust.accel_walk_m_s3),
        tilt_error_rad=trust.tilt_error_rad,
        yaw_walk_rad=trust.yaw_walk_rad,
        range_scale=0.0,
        range_offset_m=0.0,
        velocity_scale=0.0,
        velocity_error_m_s=trust.velocity_error_m_s,
        barometer_walk_m=trust.barometer_walk_m,
        b_beam=triple(-sonar.b_T_s[:3, 2]) if sonar else FilterModel.b_beam,
        b_p_imu_m=triple(imu.b_T_s[:3, 3]) if imu else FilterModel.b_p_imu_m,
        b_p_range_m=triple(sonar.b_T_s[:3, 3]) if sonar else FilterModel.b_p_range_m,
        b_p_camera_m=triple(camera.b_T_c[:3, 3]) if camera else FilterModel.b_p_camera_m,
        b_p_position_m=triple(gps.b_T_s[:3, 3]) if gps else FilterModel.b_p_position_m,
    )


def _span(flight: Flight) -> tuple[float, float]:
    """Return the interval of recorded motion. Raises ``InputError`` where there is none."""
    attitude, velocity = flight.attitude, flight.velocity
    if flight.imu is not None and len(flight.imu.stamps_s) > 1:
        stamps_s = flight.imu.stamps_s
    elif (
        attitude is not None
        and velocity is not None
        and complete(attitude.roll_pitch_yaw_rad)
        and complete(velocity.v_m_s)
    ):
        stamps_s = np.sort(np.concatenate([attitude.stamps_s, velocity.stamps_s]))
    else:
        raise InputError(
            f"{one_line(flight.name)}: too little to tell how it moved ({_missing_streams(flight)}); "
            "give it imu0, or velocity0 (both axes) with attitude0 (all three angles)"
        )
    return _begin(flight, float(stamps_s[0])), float(stamps_s[-1])


def _begin(flight: Flight, first_s: float) -> float:
    """Return when the last of the streams that begin soon after the motion has begun.

    Before that, the attitude would swing for lack of them, and the heading, exact by definition, with it.
    """
    streams = (flight.attitude, flight.velocity, flight.sonar)
    begins = [float(s.stamps_s[0]) for s in streams if s is not None and len(s.stamps_s)]
    return max([first_s, *(begin for begin in begins if begin - first_s < _NEAR_S)])


def _missing_streams(flight: Flight) -> str:
    """Return text on missing and incomplete streams among those that determine the motion."""
    missing, there = ["imu0 has 1 row" if flight.imu is not None else "no imu0"], []
    for name, series, values, columns in (
        ("attitude0", flight.attitude, "roll_pitch_yaw_rad", ("roll", "pitch", "yaw")),
        ("velocity0", flight.velocity, "v_m_s", ("v_x", "v_y")),
    ):
        if series is None:
            missing.append(f"no {name}")
            continue
        finite = np.isfinite(getattr(series, values)).any(axis=0)
        known = [column for column, is_known in zip(columns, finite, strict=True) if is_known]
        there.append(name if finite.all() else f"of {name} {' and '.join(known) or 'nothing'}")
    return "; there is ".join(part for part in (", ".join(missing), ", ".join(there)) if part)


def _adjusted(readings: Readings, adjustments: Adjustments) -> Readings:
    changed: dict[str, Any] = {}
    for name, field_name in READINGS.items():
        series = getattr(readings, field_name)
        if series is not None and (name in adjustments.noise_factor or name in adjustments.delay_s):
            late_s, noise_factor = adjustments.delay_s.get(name, 0.0), adjustments.noise_factor.get(name, 1.0)
            changed[field_name] = Series(series.stamps_s - late_s, series.values, noise_factor * series.std)
    return replace(readings, **changed)


def _start(
    flight: Flight, readings: Readings, trust: InertialTrust, start_s: float, adjustments: Adjustments
) -> InitialState:
    """Return the initial state from the first readings, the first picture and the heading that was found."""
    positions, first = readings.w_p_antenna_m, adjustments.start
    heading = adjustments.heading or StartHeading(0.0, START_YAW_STD_RAD if positions is not None else 0.0)
    w_R_b, tilt_std = _first_rotation(readings, start_s, trust.tilt_error_rad, heading.yaw_rad)
    height_m, height_std_m = _first_height(flight, readings, start_s, first)
    # Pictures are to overlap, so that a vehicle moves as many heights a second however high it flies.
    speed_std_m_s = trust.start_speed_m_s * max(1.0, first.height_m if first else 0.0)
    place_m, place_std_m = _first_place(flight, readings, w_R_b)
    velocity = _early(readings.velocity_m_s, start_s)
    w_v = np.zeros(3)
    if velocity is not None:
        nose = w_R_b[:2, 0] / np.linalg.norm(w_R_b[:2, 0])
        w_v[:2] = nose[0] * velocity[0] - nose[1] * velocity[1], nose @ velocity[::-1]
    return InitialState(
        height_m=height_m,
        height_std_m=height_std_m,
        w_R_b=w_R_b,
        tilt_std_rad=tilt_std,
        yaw_std_rad=heading.std_rad,
        place_m=place_m,
        place_std_m=place_std_m,
        w_v_m_s=w_v,
        velocity_std_m_s=speed_std_m_s if velocity is None else 0.2 + 0.1 * float(np.hypot(*velocity)),
        # At rest, wind and acceleration do not disturb the tilt of the on-board attitude.
        tilt_error_rad=None if readings.rest_m_s is None else min(_REST_TILT_RAD, trust.tilt_error_rad),
        yaw_zero_std_rad=0.3 if positions is not None else 1.0,
        position_zero_std_m=100.0 if _with_altitude(readings) and readings.range_m is not None else 0.0,
    )


def _first_place(flight: Flight, readings: Readings, w_R_b: Array) -> tuple[tuple[float, float], float]:
    """Return the place (x, y) of the body's origin at the start in metres, and its standard deviation along
    each axis; ``w_R_b`` (3, 3) is the rotation there."""
    positions = readings.w_p_antenna_m
    if positions is None:
        return (0.0, 0.0), 0.0
    assert flight.gps is not None
    b_p_antenna_m = flight.gps.b_T_s[:3, 3]
    x, y, _ = triple(positions.values[0] - w_R_b @ b_p_antenna_m)
    # The heading may be any, and turns the lever of the antenna: its whole length is uncertain.
    return (x, y), float(np.hypot(positions.std[0, 0], np.linalg.norm(b_p_antenna_m)))


def _first_height(
    flight: Flight, readings: Readings, start_s: float, first: PictureStart | None
) -> tuple[float, float]:
    """Return the height at the start, and its standard deviation."""
    height = _early(readings.range_m, start_s)
    if height is not None:
        return float(height[0]), 0.3
    if first is not None:
        return first.height_m, _HEIGHT_STD * first.height_m
    least_m = flight.sonar.min_range_m if flight.sonar else 0.0
    if readings.range_m is None and not _with_altitude(readings):  # heights are then relative to the start
        return least_m / 2, 0.0
    at_rest = readings.rest_m_s is not None and least_m > 0  # a vehicle is then below the least range
    return least_m / 2, least_m / 2 if at_rest else 1.0


def _with_altitude(readings: Readings) -> bool:
    positions = readings.w_p_antenna_m
    return positions is not None and bool(np.isfinite(positions.values[:, 2]).any())


def _early(series: Series | None, start_s: float) -> Array | None:
    """Return the first complete reading (d,), if it is near enough to the start."""
    if series is None:
        return None
    rows = np.flatnonzero(np.isfinite(series.values).all(axis=1))
    if len(rows) == 0 or series.stamps_s[rows[0]] - start_s > _NEAR_S:
        return None
    return np.asarray(series.values[rows[0]])


def _first_rotation(
    readings: Readings, start_s: float, tilt_error_rad: float, yaw_rad: float
) -> tuple[Array, float]:
    """Return the rotation (3, 3) at the start and the standard deviation of its tilt; ``yaw_rad`` is its
    heading where none is read."""
    own, accel = readings.roll_pitch_yaw_rad, readings.accel_m_s2
    first = _early(own, start_s)
    if first is not None:
        # The deviation exceeds that of the reading, which the filter uses once more.
        std = max(3 * float(np.max(own.std[:2])), tilt_error_rad, _REST_TILT_RAD) if own else 0.1
        return rotation_of(first), std
    yaw = yaw_rad
    if own is not None:
        known = own.values[np.isfinite(own.values[:, 2]), 2]
        yaw = float(known[0]) if len(known) else yaw_rad
    headed = Rotation.from_euler("z", yaw)
    if accel is None:
        return headed.as_matrix(), 0.3
    up = np.nanmean(accel.values[accel.stamps_s <= start_s + _NEAR_S], axis=0)
    # The shortest rotation that aligns the specific force with the vertical.
    level, _ = Rotation.align_vectors([[0.0, 0.0, 1.0]], [up])
    return (headed * level).as_matrix(), 0.2
