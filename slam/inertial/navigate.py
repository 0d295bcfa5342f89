"""The task of ``slam estimate``: the motion of a flight from its instruments, without pictures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from backend.ekf import records as status
from backend.preintegration.integrals import integrate
from slam.core.arguments import check_flight
from slam.core.errors import InputError
from slam.core.estimate import Estimate
from slam.core.flight_info import anomalies
from slam.core.messages import Message, joined, warning
from slam.core.progress import Progress, show_compilation, silent
from slam.core.repeated_readings import without_held_readings, without_stale_fixes
from slam.core.rotations import roll_pitch_yaw_of, rotation_of
from slam.core.stage_timer import Stopwatch
from slam.core.turn_units import in_radians
from slam.inertial.accuracy_basis import track_accuracy_basis
from slam.inertial.filter_input import FilterInput
from slam.inertial.fix_residuals import fix_contradiction
from slam.inertial.instrument_checks import checked
from slam.inertial.instruments import InertialTrust
from slam.inertial.motion import filter_motion
from slam.inertial.noise_identification import identify_noise

if TYPE_CHECKING:
    from backend.ekf.results import States, Track
    from slam.core.flight import Flight

Array = NDArray[np.float64]

TRAJECTORY_NAMES = ("dead reckoning on board", "filter", "smoothed")
"""Names of the three trajectories of such an estimate."""
MOST_POSES = 200_000
CONTRADICTION_FACTOR = 100.0
"""Factor on the nominal noise that counts as a contradiction. A few are usual; vibration gives thirty."""
_IMPLAUSIBLE_SIGMAS = 5.0
"""Standard deviations of an offset that no working sensor has."""
_LEAST_PAUSE_S, _LEAST_LOSS_M = 1.0, 1.0
"""Pause that filters of an instrument never cause, and uncertainty of a position that a track may do with."""
_REPORTED_TILT_DEG, _REPORTED_SCALE = 3.0, 1e-6
"""Error of the on-board tilt, and standard deviation of a fixed scale, above which a warning is given."""


@dataclass(frozen=True)
class Navigation:
    """The estimate, with the filter's result and its inputs."""

    estimate: Estimate
    track: Track
    inputs: FilterInput


def navigate(
    flight: Flight,
    trust: InertialTrust = InertialTrust(),
    rate_hz: float = 20.0,
    progress: Progress = silent,
) -> Navigation:
    """Estimate ``rate_hz`` poses a second: smoothed, filtered, and by on-board dead reckoning.

    Raises ``InputError`` where the recording is insufficient, or would give more than ``MOST_POSES`` poses.
    """
    check_flight(flight)
    flight, clock = in_radians(without_stale_fixes(without_held_readings(flight))), Stopwatch()
    with show_compilation(progress):
        with clock("instruments"):
            flight, contradictions = checked(flight, trust)
            inputs = identify_noise(flight, trust, progress)
        at_s = _times(flight, inputs, rate_hz)
        absolute = inputs.readings.w_p_antenna_m is not None
        with clock("filter"):
            track = filter_motion(inputs, at_s, keep="none" if absolute else "first", progress=progress)
    assert track.smoothed is not None
    turn = _heading(inputs, track.smoothed)
    track = replace(track, filtered=_rotated(track.filtered, turn), smoothed=_rotated(track.smoothed, turn))
    assert track.smoothed is not None
    covariances = track.smoothed.covariances if absolute else _since_first(track.smoothed)
    position_std = np.sqrt(np.trace(covariances[:, 3:, 3:], axis1=1, axis2=2))
    reasons = [
        *_unobserved(inputs, float(position_std[-1])),
        *_lost_in_pauses(inputs, at_s, position_std),
        *_contradicted(inputs),
        *_implausible_offsets(track.smoothed, trust),
        *(line for line in [fix_contradiction(inputs, track.smoothed, at_s, trust)] if line),
    ]
    stamps_ns = flight.epoch_ns + np.round(at_s * 1e9).astype(np.int64)
    estimate = Estimate(
        name=flight.name,
        epoch_ns=flight.epoch_ns,
        stamps_s=at_s,
        frame_names=tuple(str(stamp) for stamp in stamps_ns.tolist()),
        frame_index=np.arange(len(at_s)),
        w_T_b=track.smoothed.w_T_b,
        covariances=covariances,
        over_floor_covariances=np.full_like(covariances, np.nan),
        component=np.zeros(len(at_s), np.int64),
        camera=None,
        floor_z_m=0.0,
        origin=flight.geo_origin() if absolute else None,
        relative_poses=(),
        loops=(),
        chain_w_T_b=dead_reckoning(flight, track.smoothed.w_T_b, at_s),
        odometry_w_T_b=track.filtered.w_T_b,
        rejected=rejection_counts(track) | downweight_counts(track),
        timing_s=clock.seconds,
        messages=joined(
            *(each.as_reason() for each in reasons),
            *contradictions,
            *flight.messages,
            *anomalies(flight),
            *map(warning, _identified_errors(inputs, track)),
        ),
        trajectory_names=TRAJECTORY_NAMES,
        accuracy_basis=track_accuracy_basis(inputs.readings, trust, inputs.end_s - inputs.start_s),
    )
    return Navigation(estimate, track, inputs)


def _since_first(states: States) -> Array:
    """Return covariances (n, 6, 6) of the poses with the first position as origin, certain by definition."""
    first = np.zeros((6, 6))
    first[:3, :3] = states.covariances[0, :3, :3]
    return np.concatenate([first[None], states.fixed_clone_covariances[1:]])


def _times(flight: Flight, inputs: FilterInput, rate_hz: float) -> Array:
    count = (inputs.end_s - inputs.start_s) * rate_hz
    if count > MOST_POSES:
        raise InputError(
            f"{flight.name}: {inputs.end_s - inputs.start_s:.0f} s at {rate_hz:g} Hz are more than "
            f"{MOST_POSES} poses; lower --rate"
        )
    return inputs.start_s + np.arange(int(count) + 1) / rate_hz


def dead_reckoning(flight: Flight, w_T_b: Array, at_s: Array) -> Array:
    """Return poses (n, 4, 4) from the velocity integrated along the on-board yaw, without a filter.

    The first position, roll, pitch and height are those of ``w_T_b`` (n, 4, 4). The result is NaN where the
    flight has no velocity or yaw.
    """
    velocity, attitude = flight.velocity, flight.attitude
    if velocity is None or attitude is None:
        return np.full_like(w_T_b, np.nan)
    valid = np.isfinite(velocity.v_m_s).all(axis=1)
    with_yaw = np.isfinite(attitude.roll_pitch_yaw_rad[:, 2])
    if valid.sum() < 2 or with_yaw.sum() < 2:
        return np.full_like(w_T_b, np.nan)
    stamps_s, v = velocity.stamps_s[valid], velocity.v_m_s[valid]
    yaw_rad = np.unwrap(attitude.roll_pitch_yaw_rad[with_yaw, 2])

    def yaw_at(t: Array) -> Array:
        return np.asarray(np.interp(t, attitude.stamps_s[with_yaw], yaw_rad))

    along = (v[:, 0] + 1j * v[:, 1]) * np.exp(1j * yaw_at(stamps_s))
    path = integrate(stamps_s, along)
    position = np.interp(at_s, stamps_s, path.real) + 1j * np.interp(at_s, stamps_s, path.imag)
    poses = w_T_b.copy()
    poses[:, 0, 3] = w_T_b[0, 0, 3] + position.real - position.real[0]
    poses[:, 1, 3] = w_T_b[0, 1, 3] + position.imag - position.imag[0]
    roll_pitch_yaw = roll_pitch_yaw_of(w_T_b[:, :3, :3])
    roll_pitch_yaw[:, 2] = yaw_at(at_s)
    poses[:, :3, :3] = rotation_of(roll_pitch_yaw)
    return poses


def _heading(inputs: FilterInput, states: States) -> float:
    """Return the yaw that aligns the world with the median of the on-board yaw; 0 with GPS."""
    own = inputs.readings.roll_pitch_yaw_rad
    if inputs.readings.w_p_antenna_m is not None or own is None or not np.isfinite(own.values[:, 2]).any():
        return 0.0
    return float(np.median(states.errors["own_attitude"][:, 2]))


def _rotated(states: States, yaw_rad: float) -> States:
    """Rotate the world about the first position; covariances of poses are in body axes and stay."""
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_euler("z", yaw_rad).as_matrix()
    wide = np.kron(np.diag([1, 1, 1, 0]), turn[:3, :3]) + np.kron(np.diag([0, 0, 0, 1]), np.eye(3))
    first = states.w_T_b[0, :3, 3] * [1, 1, 0]
    w_T_b = states.w_T_b.copy()
    w_T_b[:, :3, 3] -= first
    w_T_b = turn @ w_T_b
    w_T_b[:, :3, 3] += first
    own = states.errors["own_attitude"] - [0.0, 0.0, yaw_rad]
    return replace(
        states,
        w_T_b=w_T_b,
        w_v_m_s=states.w_v_m_s @ turn[:3, :3].T,
        w_a_m_s2=states.w_a_m_s2 @ turn[:3, :3].T,
        motion_covariances=wide @ states.motion_covariances @ wide.T,
        errors={**states.errors, "own_attitude": own},
    )


def _unobserved(inputs: FilterInput, position_std_m: float) -> list[Message]:
    """Return warnings about quantities without a measurement."""
    readings, messages = inputs.readings, list[Message]()
    if readings.velocity_m_s is None and readings.w_p_antenna_m is None:
        messages.append(
            warning(
                "neither velocity nor position was measured: the position drifts, to "
                f"±{position_std_m:.2g} m at the end"
            )
        )
    heading = inputs.adjustments.heading
    if heading is not None and not heading.is_known:
        messages.append(
            warning(
                "the heading is unknown: no yaw was measured, and the positions fit several headings",
                "give attitude0 a yaw, or fly with changes of speed",
            )
        )
    with_altitude = (
        readings.w_p_antenna_m is not None and np.isfinite(readings.w_p_antenna_m.values[:, 2]).any()
    )
    if readings.range_m is None and not with_altitude:
        messages.append(warning("neither range nor altitude was measured: heights are relative to the start"))
    return messages


def _lost_in_pauses(inputs: FilterInput, at_s: Array, position_std_m: Array) -> list[Message]:
    """Return a message where a pause of all instruments of the motion causes most of the position's error."""
    motion = (inputs.readings.gyro_rad_s, inputs.readings.velocity_m_s, inputs.readings.w_p_antenna_m)
    stamps_s = np.unique(np.concatenate([series.stamps_s for series in motion if series is not None]))
    gaps = np.flatnonzero(np.diff(stamps_s) > _LEAST_PAUSE_S)
    lost = []
    for last_s, next_s in zip(stamps_s[gaps].tolist(), stamps_s[gaps + 1].tolist(), strict=True):
        before, after = (int(np.searchsorted(at_s, t).clip(0, len(at_s) - 1)) for t in (last_s, next_s))
        if position_std_m[after] > 2 * position_std_m[max(before - 1, 0)] + _LEAST_LOSS_M:
            lost.append(f"from {last_s:.1f} to {next_s:.1f} s (±{position_std_m[after]:.2g} m)")
    if not lost:
        return []
    more = f" and {len(lost) - 3} times more" if len(lost) > 3 else ""
    return [
        warning(
            f"neither IMU, velocity nor position was recorded {', '.join(lost[:3])}{more}: how far the "
            "vehicle moved meanwhile is unknown, and all later positions are off by as much"
        )
    ]


def rejection_counts(track: Track) -> dict[str, int]:
    """Return the number of rejected components of readings, by channel and reason."""
    reasons = {
        status.REJECTED: "far from what was foreseen",
        status.UNPREDICTABLE: "impossible in that attitude",
    }
    return _counted(track, reasons)


def downweight_counts(track: Track) -> dict[str, int]:
    """Return the number of components of readings with reduced weight, by channel and reason."""
    return _counted(track, {status.INFLATED: "off, taken with less weight"})


def _counted(track: Track, reasons: Mapping[int, str]) -> dict[str, int]:
    return {
        f"{name}: {reason}": count
        for name, channel in track.channels.items()
        for code, reason in reasons.items()
        if (count := channel.count(code))
    }


def _contradicted(inputs: FilterInput) -> list[Message]:
    """Return warnings about instruments whose errors far exceed noise."""
    return [
        warning(
            f"{name} and the other instruments contradict each other (off by {factor:.0f} times its noise)",
            "check its unit and stamps, and whether another instrument has failed",
        )
        for name, factor in inputs.adjustments.noise_factor.items()
        if factor >= CONTRADICTION_FACTOR
    ]


def _implausible_offsets(states: States, trust: InertialTrust) -> list[Message]:
    """Return a message for each offset of the IMU that is far beyond what is assumed of one."""
    messages = []
    for name, words, unit, usual in (
        ("gyro_offset", "gyro", "rad/s", trust.gyro_offset_rad_s),
        ("accel_offset", "accelerometer", "m/s²", trust.accel_offset_m_s2),
    ):
        largest = float(np.abs(states.errors[name][-1]).max())
        if largest > _IMPLAUSIBLE_SIGMAS * usual:
            messages.append(
                warning(
                    f"the {words} and the other instruments contradict each other (it would be off by "
                    f"{largest:.2g} {unit}, {usual:g} is usual)",
                    "check their axes, units and stamps",
                )
            )
    return messages


def _identified_errors(inputs: FilterInput, track: Track) -> list[str]:
    """Return one line for each instrument error that was identified."""
    noise_factor = inputs.adjustments.noise_factor
    contradicted = any(factor >= CONTRADICTION_FACTOR for factor in noise_factor.values())
    # With a gross contradiction the identified delays are wrong too.
    late = {} if contradicted else inputs.adjustments.delay_s
    messages = [f"{name} lags by {delay_s:g} s, which is corrected" for name, delay_s in late.items()]
    messages += [
        f"{name} is {factor:.1f} times as noisy as specified"
        for name, factor in noise_factor.items()
        if factor < CONTRADICTION_FACTOR
    ]
    for name, channel in track.channels.items():
        if steps := channel.count(status.BIAS_STEPPED):
            times = "once" if steps == 1 else f"{steps} times"
            messages.append(f"{name} jumped {times}: taken for an error of the sensor, not for motion")
    assert track.smoothed is not None
    errors, std = track.smoothed.errors, track.smoothed.errors_std
    for name, words, unit in (
        ("accel_offset", "accelerometer", "m/s²"),
        ("gyro_offset", "gyro", "rad/s"),
    ):
        last, known = errors[name][-1], std[name][-1]
        if (np.abs(last) > 5 * known).any() and (known > 1e-6).any():
            messages.append(f"{words} is off by {', '.join(f'{v:.3g}' for v in last)} {unit}")
    tilt = np.degrees(np.abs(errors["own_attitude"][:, :2]).max())
    if inputs.model.tilt_error_rad > 0 and tilt > _REPORTED_TILT_DEG:
        messages.append(f"the vehicle's own roll and pitch are off by up to {tilt:.1f} deg")
    for scale, words in ((inputs.velocity_scale_std, "velocities"), (inputs.range_scale_std, "ranges")):
        if scale > _REPORTED_SCALE:
            messages.append(
                f"the scale of {words} cannot be determined from this flight: it is known to "
                f"{100 * scale:.2g} % only"
            )
    return messages
