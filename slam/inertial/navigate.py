"""The job of ``slam estimate``: a flight's motion from its instruments alone, no picture looked at."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from backend.ekf import records as status
from slam.core.arguments import check_flight
from slam.core.errors import InputError
from slam.core.estimate import Estimate
from slam.core.flight_info import describe
from slam.core.progress import Progress, show_compilation, silent
from slam.core.rotations import roll_pitch_yaw_of, rotation_of
from slam.core.stage_timer import Stopwatch
from slam.inertial.filter_input import FilterInput
from slam.inertial.instruments import InertialTrust
from slam.inertial.motion import filter_motion
from slam.inertial.noise_identification import identify_noise

if TYPE_CHECKING:
    from backend.ekf.results import States, Track
    from slam.core.flight import Flight

Array = NDArray[np.float64]

WAYS = ("dead reckoning on board", "filter", "smoothed")
"""What the three trajectories of such an estimate are."""
MOST_POSES = 200_000
CONTRADICTED = 100.0
"""Times the noise that is told: a few are usual, an accelerometer on a frame that shakes has thirty."""
_TOLD_TILT_DEG, _TOLD_SCALE = 3.0, 1e-6
"""An own attitude that is off by more, and a scale that is held and less well known, are told."""


@dataclass(frozen=True)
class Navigation:
    """The estimate, and what stands behind it."""

    estimate: Estimate
    track: Track
    inputs: FilterInput


def navigate(
    flight: Flight,
    trust: InertialTrust = InertialTrust(),
    rate_hz: float = 20.0,
    progress: Progress = silent,
) -> Navigation:
    """Poses ``rate_hz`` times a second: smoothed, filtered, and as dead reckoning on board would have it.

    Raises ``InputError`` where the flight tells too little, or would give more than ``MOST_POSES`` poses.
    """
    check_flight(flight)
    clock = Stopwatch()
    with show_compilation(progress):
        with clock("instruments"):
            inputs = identify_noise(flight, trust, progress)
        at_s = _times(flight, inputs, rate_hz)
        absolute = inputs.readings.w_p_b_m is not None
        with clock("filter"):
            track = filter_motion(inputs, at_s, keep="none" if absolute else "first", progress=progress)
    assert track.smoothed is not None
    turn = _heading(inputs, track.smoothed)
    track = replace(track, filtered=_turned(track.filtered, turn), smoothed=_turned(track.smoothed, turn))
    assert track.smoothed is not None
    covariances = track.smoothed.covariances if absolute else _since_first(track.smoothed)
    known_to = np.sqrt(np.trace(covariances[:, 3:, 3:], axis1=1, axis2=2))
    said = [*_unobserved(inputs, float(known_to[-1])), *_contradicted(inputs)]
    stamps_ns = flight.epoch_ns + np.round(at_s * 1e9).astype(np.int64)
    estimate = Estimate(
        name=flight.name,
        status="; ".join(said) or "ok",
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
        warnings=(*flight.warnings, *describe(flight).anomalies, *said, *_found_odd(inputs, track)),
        trajectory_names=WAYS,
    )
    return Navigation(estimate, track, inputs)


def _since_first(states: States) -> Array:
    """Covariances (n, 6, 6) of the poses where the first one's place is certain, as it is by definition."""
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
    """Poses (n, 4, 4) from the velocity added up along the vehicle's own yaw, as on board without a filter.

    They start where ``w_T_b`` (n, 4, 4) does; roll, pitch and height are its. NaN where the flight has no
    velocity and yaw.
    """
    velocity, attitude = flight.velocity, flight.attitude
    if velocity is None or attitude is None:
        return np.full_like(w_T_b, np.nan)
    moving = np.isfinite(velocity.v_m_s).all(axis=1)
    headed = np.isfinite(attitude.roll_pitch_yaw_rad[:, 2])
    if moving.sum() < 2 or headed.sum() < 2:
        return np.full_like(w_T_b, np.nan)
    stamps_s, v = velocity.stamps_s[moving], velocity.v_m_s[moving]
    yaw_rad = np.unwrap(attitude.roll_pitch_yaw_rad[headed, 2])

    def yaw_at(t: Array) -> Array:
        return np.asarray(np.interp(t, attitude.stamps_s[headed], yaw_rad))

    along = (v[:, 0] + 1j * v[:, 1]) * np.exp(1j * yaw_at(stamps_s))
    way = np.concatenate([[0.0], np.cumsum((along[1:] + along[:-1]) / 2 * np.diff(stamps_s))])
    placed = np.interp(at_s, stamps_s, way.real) + 1j * np.interp(at_s, stamps_s, way.imag)
    poses = w_T_b.copy()
    poses[:, 0, 3] = w_T_b[0, 0, 3] + placed.real - placed.real[0]
    poses[:, 1, 3] = w_T_b[0, 1, 3] + placed.imag - placed.imag[0]
    roll_pitch_yaw = roll_pitch_yaw_of(w_T_b[:, :3, :3])
    roll_pitch_yaw[:, 2] = yaw_at(at_s)
    poses[:, :3, :3] = rotation_of(roll_pitch_yaw)
    return poses


def _heading(inputs: FilterInput, states: States) -> float:
    """By how much to turn the world so that the vehicle's own yaw is right in the middle; 0 where GPS
    tells."""
    own = inputs.readings.roll_pitch_yaw_rad
    if inputs.readings.w_p_b_m is not None or own is None or not np.isfinite(own.values[:, 2]).any():
        return 0.0
    return float(np.median(states.errors["own_attitude"][:, 2]))


def _turned(states: States, yaw_rad: float) -> States:
    """The same in a world turned about the first place; covariances of poses are in body axes and stay."""
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


def _unobserved(inputs: FilterInput, known_to_m: float) -> list[str]:
    """What nothing measures, in words."""
    readings, said = inputs.readings, []
    if readings.velocity_m_s is None and readings.w_p_b_m is None:
        said.append(
            "neither velocity nor position was measured: the position drifts, "
            f"to ±{known_to_m:.2g} m at the end"
        )
    with_altitude = readings.w_p_b_m is not None and np.isfinite(readings.w_p_b_m.values[:, 2]).any()
    if readings.range_m is None and not with_altitude:
        said.append("neither range nor altitude was measured: heights are relative to the start")
    return said


def rejection_counts(track: Track) -> dict[str, int]:
    """Components of readings that were left out, by reason."""
    reasons = {
        status.REJECTED: "far from what was foreseen",
        status.UNPREDICTABLE: "impossible in that attitude",
    }
    return _counted(track, reasons)


def downweight_counts(track: Track) -> dict[str, int]:
    """Components of readings that count for less than their noise says, by reason."""
    return _counted(track, {status.INFLATED: "off, taken with less weight"})


def _counted(track: Track, reasons: Mapping[int, str]) -> dict[str, int]:
    return {
        f"{name}: {reason}": count
        for name, channel in track.channels.items()
        for code, reason in reasons.items()
        if (count := channel.count(code))
    }


def _contradicted(inputs: FilterInput) -> list[str]:
    """Instruments that are so far from what the others foretell that noise is no word for it."""
    return [
        f"{name} and the other instruments contradict each other (off by {factor:.0f} times its noise); "
        "check its unit and stamps, and whether another instrument has failed"
        for name, factor in inputs.adjustments.noise_factor.items()
        if factor >= CONTRADICTED
    ]


def _found_odd(inputs: FilterInput, track: Track) -> list[str]:
    """What the filter has found of the instruments, one line each."""
    noise_factor = inputs.adjustments.noise_factor
    wild = any(factor >= CONTRADICTED for factor in noise_factor.values())
    # Where instruments contradict each other grossly, so does what makes them agree best.
    late = {} if wild else inputs.adjustments.delay_s
    said = [f"{name} lags by {delay_s:g} s, which is corrected" for name, delay_s in late.items()]
    said += [
        f"{name} is {factor:.1f} times as noisy as specified"
        for name, factor in noise_factor.items()
        if factor < CONTRADICTED
    ]
    for name, channel in track.channels.items():
        if steps := channel.count(status.BIAS_STEPPED):
            times = "once" if steps == 1 else f"{steps} times"
            said.append(f"{name} jumped {times}: taken for an error of the sensor, not for motion")
    assert track.smoothed is not None
    errors, std = track.smoothed.errors, track.smoothed.errors_std
    for name, words, unit in (
        ("accel_offset", "accelerometer", "m/s²"),
        ("gyro_offset", "gyro", "rad/s"),
    ):
        last, known = errors[name][-1], std[name][-1]
        if (np.abs(last) > 5 * known).any() and (known > 1e-6).any():
            said.append(f"{words} is off by {', '.join(f'{v:.3g}' for v in last)} {unit}")
    tilt = np.degrees(np.abs(errors["own_attitude"][:, :2]).max())
    if inputs.model.tilt_error_rad > 0 and tilt > _TOLD_TILT_DEG:
        said.append(f"the vehicle's own roll and pitch are off by up to {tilt:.1f} deg")
    for scale, words in ((inputs.velocity_scale_std, "velocities"), (inputs.range_scale_std, "ranges")):
        if scale > _TOLD_SCALE:
            said.append(
                f"the scale of {words} cannot be determined from this flight: it is known to "
                f"{100 * scale:.2g} % only"
            )
    return said
