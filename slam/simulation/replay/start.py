"""The initial state of a roll-out, estimated from the readings around its start.

Each quantity is the value of a straight line fitted to the readings of a short window. Errors of the
instruments in the model (a scale, a tilt) are inverted.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from slam.core.flight import Flight
from slam.simulation import sensors
from slam.simulation.model import Model
from slam.simulation.motion import State, at_rest
from slam.simulation.replay.channels import level_ground, truth_angles

Array = NDArray[np.float64]
Source = Literal["instruments", "truth"]

ANGLES_S, TURN_S, RATES_S, SPEED_S, HEIGHT_S, PLACE_S = 0.06, 0.15, 0.05, 0.15, 0.3, 0.1
"""Half the window of each quantity; quantities that change quickly have short windows."""
FEWEST = 4
"""Least number of readings in a window."""
WINDOW_FACTORS = (1.0, 2.0, 4.0)
"""Factors by which the window grows where readings are sparse."""
FAR_UP_M = 50.0
"""Height without a measurement, so that the floor has no effect."""
ROUNDS = 8
"""Iterations of the inversion: an error of a quarter shrinks to a part in 60 000."""


class StartEstimator:
    """Estimator of the states of a flight, by the instruments of a model."""

    def __init__(self, flight: Flight, model: Model, span_s: tuple[float, float]) -> None:
        self._flight, self._model, self._span_s = flight, model, span_s
        self._world = level_ground(model)
        self._truth_angles = truth_angles(flight.truth) if flight.truth is not None else np.empty((0, 3))
        speed, sonar = flight.velocity, flight.sonar
        self._has_speed = speed is not None and bool(np.isfinite(speed.v_m_s).any())
        self._has_range = sonar is not None and bool(np.isfinite(sonar.range_m).any())
        self.source: Source = "truth" if flight.truth is not None and not self._has_speed else "instruments"
        """Source of the states."""
        warnings = []
        if flight.truth is None and not self._has_speed:
            warnings.append("no speed was measured: roll-outs begin at rest")
        if flight.truth is None and not self._has_range:
            warnings.append("no height was measured: roll-outs begin far above the floor")
        self.warnings = tuple(warnings)
        """Assumptions, one line each."""

    def at(self, time_s: float) -> Array | None:
        """Return the state (``dynamics.STATE``,) at one moment; None where a stream has a gap there."""
        found = self._from_truth(time_s) if self.source == "truth" else self._from_instruments(time_s)
        if not np.isfinite(found).all():
            return None
        gear_m = self._model.vehicle.gear_height_m
        if found[2] < gear_m:
            # A vehicle below the floor would be thrown up by the spring of its landing gear.
            found[2], found[5] = gear_m, max(found[5], 0.0)
        return found

    def _from_truth(self, time_s: float) -> Array:
        truth = self._flight.truth
        assert truth is not None
        p, v = line(truth.stamps_s, truth.w_T_b[:, :3, 3], time_s, PLACE_S)
        if truth.w_v_m_s is not None:
            v, _ = line(truth.stamps_s, truth.w_v_m_s, time_s, SPEED_S)
        angles, _ = line(truth.stamps_s, self._truth_angles, time_s, ANGLES_S)
        _, turn = line(truth.stamps_s, self._truth_angles, time_s, TURN_S)
        return _state(p, v, angles, float(turn[2]))

    def _from_instruments(self, time_s: float) -> Array:
        angles, yaw_rate = self._attitude(time_s)
        rates = self._body_rates(time_s)
        if np.isfinite(rates).all():
            yaw_rate = float(rates[1] * np.sin(angles[0]) + rates[2] * np.cos(angles[0])) / np.cos(angles[1])
        p, v_up = self._place(time_s)
        speed = np.zeros(2)
        if self._flight.velocity is not None and self._has_speed:
            stamps = sensors.sampling_times(self._flight.velocity.stamps_s, self._model)
            speed, _ = line(stamps, self._flight.velocity.v_m_s, time_s, SPEED_S)
        state = _state(p, np.array([0.0, 0.0, v_up]), angles, yaw_rate)
        return self._without_instrument_errors(state, np.nan_to_num(rates), speed, time_s)

    def _attitude(self, time_s: float) -> tuple[Array, float]:
        """Return roll, pitch, yaw and the yaw rate; 0 where the flight has none."""
        series = self._flight.attitude
        if series is None:
            return np.zeros(3), 0.0
        stamps, values = (
            sensors.sampling_times(series.stamps_s, self._model),
            _unwrapped(series.roll_pitch_yaw_rad),
        )
        angles, _ = line(stamps, values, time_s, ANGLES_S)
        _, turn = line(stamps, values, time_s, TURN_S)
        return angles, float(turn[2])

    def _body_rates(self, time_s: float) -> Array:
        """Return the body rates (3,) by the gyro, corrected by the model; NaN without one."""
        imu, model = self._flight.imu, self._model
        if imu is None:
            return np.full(3, np.nan)
        gyro, _ = line(sensors.sampling_times(imu.stamps_s, model), imu.gyro_rad_s, time_s, RATES_S)
        rates = (imu.b_T_s[:3, :3] @ gyro - model.vector("gyro_bias")) / (
            1 + model.value("gyro_scale", "eps")
        )
        return np.asarray(Rotation.from_rotvec(model.vector("imu_misalignment")).apply(rates))

    def _place(self, time_s: float) -> tuple[Array, float]:
        """Return the position (3,) and the climb rate. Instruments give the height only."""
        p, climb = np.array([0.0, 0.0, FAR_UP_M]), 0.0
        if self._flight.truth is not None:
            truth = self._flight.truth
            p, v = line(truth.stamps_s, truth.w_T_b[:, :3, 3], time_s, PLACE_S)
            climb = float(v[2])
        if self._flight.sonar is not None and self._has_range:
            sonar = self._flight.sonar
            late = time_s + self._model.value("sonar_lag", "T")
            stamps = sensors.sampling_times(sonar.stamps_s, self._model)
            height, rise = line(stamps, sonar.range_m[:, None], late, HEIGHT_S)
            p[2], climb = height[0], float(rise[0])
        return p, climb

    def _without_instrument_errors(self, state: Array, rates: Array, speed: Array, time_s: float) -> Array:
        """Invert the errors of the instruments: find the state whose readings are ``speed`` and the range.

        The height of ``state`` is the measured range.
        """
        begin_s, end_s = self._span_s
        progress = np.array([(time_s - begin_s) / (end_s - begin_s)])
        c, s = np.cos(state[8]), np.sin(state[8])
        range_m, ahead = float(state[2]), np.zeros(2)
        for _ in range(ROUNDS):
            state[3:5] = c * ahead[0] - s * ahead[1], s * ahead[0] + c * ahead[1]
            now = State(
                np.array([time_s]), state[None, :3].copy(), state[None, 3:6], np.zeros((1, 3)),
                state[None, 6:9], rates[None],
            )  # fmt: skip
            ahead = ahead + speed - sensors.flow_speed(now, self._model, self._world, progress)[0]
            if self._has_range:
                state[2] += range_m - sensors.slant_range(now, self._model, self._world, progress)[0]
        return state


def line(stamps_s: Array, values: Array, time_s: float, half_s: float) -> tuple[Array, Array]:
    """Return value and slope (k,) at ``time_s`` of straight lines through the columns (n, k) near it.

    An empty column gives 0. The result is NaN where there is no value within ``half_s``, or too few near it.
    """
    value, slope = np.zeros(values.shape[1]), np.zeros(values.shape[1])
    for k, column in enumerate(values.T):
        known = np.isfinite(column)
        if not known.any():
            continue
        value[k] = slope[k] = np.nan
        if np.abs(stamps_s[known] - time_s).min() > half_s:
            continue
        for factor in WINDOW_FACTORS:
            near = known & (np.abs(stamps_s - time_s) <= factor * half_s)
            if near.sum() >= FEWEST:
                slope[k], value[k] = np.polyfit(stamps_s[near] - time_s, column[near], 1)
                break
    return value, slope


def _unwrapped(angles: Array) -> Array:
    """Return roll, pitch and unwrapped yaw; missing values stay missing."""
    out = angles.copy()
    known = np.isfinite(out[:, 2])
    out[known, 2] = np.unwrap(out[known, 2])
    return out


def _state(p: Array, v: Array, angles: Array, yaw_rate: float) -> Array:
    state = at_rest(p[0], p[1], p[2], angles[2])
    state[3:6], state[6:9], state[9] = v, angles, yaw_rate
    return state
